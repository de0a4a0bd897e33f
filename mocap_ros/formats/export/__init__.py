"""Files written for animation and biomechanics."""
