"""With which code a command ends, and the error that ends it early.

- 0: done.
- 1: the service, its models or the machine failed; `doctor` found something to mend.
- 2: wrong usage: an option, a file or a setting that cannot be used.
- 3: the request was refused: what was asked cannot be answered.
- 130: interrupted.
"""

from __future__ import annotations

OK, FAILED, USAGE, REFUSED, INTERRUPTED = 0, 1, 2, 3, 130

EPILOG = (
    "exit codes: 0 done, 1 the service, its models or the machine failed, 2 wrong usage, 3 the request was refused, "
    "130 interrupted"
)


class UsageError(Exception):
    """Something on the command line cannot be used."""
