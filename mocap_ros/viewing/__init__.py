"""Pictures of sequences, reconstructions and keyframes."""
