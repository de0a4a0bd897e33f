"""Pictures, pages for a browser and recordings for Rerun, of sequences, reconstructions and keyframes."""
