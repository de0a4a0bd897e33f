"""Figures of sequences, reconstructions and keyframes."""
