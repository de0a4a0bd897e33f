"""From the bytes of an input message to the bytes of the outputs: what the live node and a replay share."""
