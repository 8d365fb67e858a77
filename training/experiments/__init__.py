"""What the paper measured, measured again; each module is one question and prints its own table."""
