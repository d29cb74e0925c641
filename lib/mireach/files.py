"""Files are written whole or not at all, and read with an error that names the file."""

import json
import os
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

from .errors import CorruptFileError

END = "# end: {} rows"  # the last line of a table, by which a truncated one is recognized
PART = ".part"  # end of the names of files that are still being written


def write_whole(path: str | Path, content: str | bytes) -> None:
    """Write text or bytes so that a reader sees the old file or the new one, never a part.

    Parameters
    ----------
    path : str or Path
        Missing parent folders are made.
    content : str or bytes
        Text is written as UTF-8 with Unix line ends.

    Raises
    ------
    OSError
        If the file cannot be written; the error names it, and the old file stays.

    Notes
    -----
    The content goes to a file beside it, is flushed to the disk, and is renamed. A process that is killed in between
    leaves that other file, whose name ends in `PART`. Of two processes that write at once, the last one wins.
    """
    path = Path(path)
    data = content.encode() if isinstance(content, str) else content
    name = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=PART)
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(name, 0o644)
        os.replace(name, path)
    except BaseException as error:
        if name is not None:
            with suppress(OSError):
                os.unlink(name)
        if isinstance(error, OSError):
            message = f"cannot write {path}: {error.strerror or error}"
            raise (OSError(message) if error.errno is None else OSError(error.errno, message)) from error
        raise


def write_json(path: str | Path, value: Any, indent: int | None = None) -> None:
    """Write `value` as JSON whose numbers read back to the same floats; NaN and infinity are refused."""
    write_whole(path, json.dumps(value, indent=indent, allow_nan=False) + "\n")


def read_json(path: str | Path, *formats: str) -> Any:
    """Read a JSON file of this package.

    Parameters
    ----------
    path : str or Path
    *formats : str
        What the file's key "format" may say.

    Raises
    ------
    CorruptFileError
        If the file is not JSON (a truncated file is not), is nested too deeply to be read, or says another format.
    """
    try:
        value = json.loads(Path(path).read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise CorruptFileError(f"{path} is not valid JSON ({error}): restore or write it again") from error
    found = value.get("format") if isinstance(value, dict) else None
    if found not in formats:
        raise CorruptFileError(f"{path} has the format {found!r}, but {' or '.join(map(repr, formats))} is needed")
    return value
