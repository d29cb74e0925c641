"""The messages that the page of a disturbance lab sends to its kernel, read and checked."""

from typing import Any, NamedTuple

from ..checks import require_kind, whole_number
from .controls import Settings

FIELDS = {"look": ("settings", "stamp"), "idle": (), "layer": (), "save": ("kind",)}  # of each request, beside "do"
KINDS = {"figure": ("svg", "image/svg+xml"), "sets": ("json", "application/json"), "script": ("py", "text/x-python")}


class Message(NamedTuple):
    """What the page asks for.

    Attributes
    ----------
    do : str
        "look": a look at other settings; "idle": some idle work; "layer": the maximal safe set; "save": a file.
    settings : dict
        Of a look; control name -> value, not checked.
    stamp : int
        Of a look, larger than those before it; the answer repeats it.
    kind : str
        Of a file, one of `KINDS`.
    """

    do: str
    settings: Settings
    stamp: int
    kind: str


def read_message(content: Any) -> Message:
    """The message that the page has sent.

    Parameters
    ----------
    content : dict
        "do", and the `FIELDS` of that request.

    Returns
    -------
    Message

    Raises
    ------
    TypeError
        If the message or its settings are no dict; the error names what was given.
    ValueError
        If it asks for nothing that there is, lacks a field or has another, or a field has an impossible value.

    Examples
    --------
    >>> read_message({"do": "save", "kind": "sets"}).kind
    'sets'
    """
    require_kind(content, dict, "a message of the page")
    do = content.get("do")
    if not isinstance(do, str) or do not in FIELDS:
        raise ValueError(f"a message must ask for {', '.join(FIELDS)}; got {do!r:.80}")
    fields = {"do", *FIELDS[do]}
    if set(content) != fields:
        given = ", ".join(sorted(f"{name!s:.20}" for name in content))
        raise ValueError(
            f"a message that asks for {do} must have the fields {', '.join(sorted(fields))}; got {given:.200}"
        )
    settings, kind = content.get("settings", {}), content.get("kind", "")
    require_kind(settings, dict, "settings")
    if do == "save" and (not isinstance(kind, str) or kind not in KINDS):
        raise ValueError(f"a file must be of the kind {', '.join(KINDS)}; got {kind!r:.80}")
    return Message(do, settings, whole_number(content.get("stamp", 0), "stamp", 0), kind)
