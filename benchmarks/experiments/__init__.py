"""What `paper.py` and `solvers.py` run, by theme."""
