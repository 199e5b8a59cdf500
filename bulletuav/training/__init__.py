"""Training runs: kept in a folder, interrupted and resumed to the same bits."""
