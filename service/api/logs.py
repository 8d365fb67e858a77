"""Log lines: for people, or as one JSON object a line for whatever collects them."""

from __future__ import annotations

import io
import json
import logging
from datetime import UTC, datetime

TEXT = "%(asctime)s %(levelname)s %(name)s %(message)s"

_STANDARD = frozenset(logging.makeLogRecord({}).__dict__) | {"message", "asctime", "taskName"}


class JsonFormatter(logging.Formatter):
    """`time` (RFC 3339, UTC), `level`, `logger`, `message`, and whatever a line was given besides as `extra`."""

    def format(self, record: logging.LogRecord) -> str:
        line = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        line |= {
            key: value for key, value in record.__dict__.items() if key not in _STANDARD and value not in (None, "")
        }
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return json.dumps(line, ensure_ascii=False, default=str)


def configure(level: str, style: str, stream: io.TextIOBase | None = None) -> None:
    """Log to a stream.

    Args:
        level: The lowest that is written, such as `info`.
        style: `text` or `json`.
        stream: Where to; stderr where it is None.
    """
    handler = logging.StreamHandler(stream)
    handler.setFormatter(JsonFormatter() if style == "json" else logging.Formatter(TEXT))
    logging.basicConfig(level=level.upper(), handlers=[handler], force=True)
    # Uvicorn calls all of its ordinary news errors by the name of its logger, and says nothing there we do not.
    logging.getLogger("uvicorn").setLevel(max(logging.WARNING, logging.getLogger().level))
