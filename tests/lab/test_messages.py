"""Messages of the page: fields, kinds and the words of the errors."""

import pytest

from mireach.lab.messages import Message, read_message


def test_every_request_is_read():
    assert read_message({"do": "idle"}) == Message("idle", {}, 0, "")
    assert read_message({"do": "layer"}).do == "layer"
    assert read_message({"do": "look", "settings": {"amount": 1}, "stamp": 3}) == Message("look", {"amount": 1}, 3, "")
    assert read_message({"do": "save", "kind": "figure"}).kind == "figure"


@pytest.mark.parametrize(
    ("content", "error", "said"),
    [
        (["look"], TypeError, "a message of the page must be of the kind dict; got list"),
        ({"do": "look", "stamp": 1, "settings": 5}, TypeError, "settings must be of the kind dict; got int 5"),
        ({}, ValueError, "must ask for look, idle, layer, save; got None"),
        ({"do": ["look"]}, ValueError, "must ask for look, idle, layer, save"),
        ({"do": "look", "stamp": 1}, ValueError, "must have the fields do, settings, stamp; got do, stamp"),
        ({"do": "idle", 7: 1}, ValueError, "must have the fields do; got 7, do"),
        ({"do": "look", "stamp": True, "settings": {}}, ValueError, "stamp must be a whole number"),
        ({"do": "save", "kind": "png"}, ValueError, "must be of the kind figure, sets, script; got 'png'"),
    ],
)
def test_an_error_says_what_is_wrong(content, error, said):
    with pytest.raises(error) as found:
        read_message(content)
    assert said in str(found.value)
