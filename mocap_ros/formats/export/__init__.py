"""Writers of files for animation and biomechanics."""
