"""The drone: airframe, rotors, forces, wind, battery, power, and the state of a swarm."""
