"""The command `mocap-ros`, with one module for each subcommand."""
