"""Options that make a command fast where its result does not matter."""

QUICK_OPTIONS = ('--model', 'walk', '--set', 'solver.max_iterations=2')
