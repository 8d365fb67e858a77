"""Data sets: what is drawn, how it is kept, and the manifest that makes it again."""
