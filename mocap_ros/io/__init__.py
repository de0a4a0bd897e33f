"""Files and messages: everything that is read or written."""
