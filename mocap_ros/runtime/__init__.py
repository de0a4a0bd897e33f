"""Convert the bytes of input messages into the bytes of output messages, for the live node and for replays."""
