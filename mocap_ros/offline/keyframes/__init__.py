"""Long sequences by keyframes (Loy, Eriksson, Sullivan, Carlsson, ECCV 2004)."""
