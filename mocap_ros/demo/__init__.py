"""The demo recording, which is synthesised from learned motions and therefore comes with its true 3D poses."""
