"""PPO without PyTorch: compiled networks, whose weights have the same bits on any x86-64."""
