"""Real flights that the laws of flight are judged by: one file for each set of data.

Nothing of the data is part of this repository. Three public repositories are read as they are
cloned; only binned figures and errors of predictions are kept, in measured.json.

- nanobench: syediu/nanobench-iros2026 (BSD-3-Clause), positions half a second ahead.
- arpl: arplaboratory/data-driven-system-identification (MIT), body rates half a second ahead.
- neural_swarm: aerorobotics/neural-swarm (no licence seen: figures only), whose flights of pairs
  give the wake (`pairs`) and whose flights near the ground give the ground effect (`ground`).
"""
