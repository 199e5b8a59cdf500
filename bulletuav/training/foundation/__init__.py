"""One policy for all quadrotors: a recurrent network that imitates controllers of drawn ones."""
