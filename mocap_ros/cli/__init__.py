"""The command `mocap-ros`: one module a subcommand, each with `add_parser` and `run`."""
