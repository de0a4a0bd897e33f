"""Fuzz tests: bytes from strangers give a result or one clear error, in bounded memory and time."""
