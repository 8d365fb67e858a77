"""The commands of `physnet`, one module each: `add_<command>` registers its options, `run` does it."""
