"""A simulation of the whole: random operations and faults, each run replayable from one integer.

    python -m tests.simulation --seed 7 --operations 10000

`forms` draws what is built, `faces` gives every environment class one interface, `operations` and
`faults` do things to them, `invariants` tells what must hold after each, `run` does many and finds
the few that matter, `soak` flies for long.
"""
