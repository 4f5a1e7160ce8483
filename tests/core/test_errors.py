"""The words for errors."""

from __future__ import annotations

import errno

import pytest

from nrbench.errors import BadInput, describe_error, storage_fault, strip_control


def test_control_characters_are_dropped_and_lines_stay() -> None:
    """Terminal colors, bells and NUL are removed; line breaks and tabs stay."""
    assert strip_control("\x1b[1;31mred\x1b[0m\x00\x07\r\n\tb") == "red\n\tb"


def raise_error(error: BaseException) -> None:
    """Raise an error."""
    raise error


class Mute(Exception):
    """An error whose message raises an error."""

    def __str__(self) -> str:
        raise RuntimeError


def caught(error: BaseException) -> BaseException:
    """Return an error after it was raised."""
    with pytest.raises(type(error)) as info:
        raise_error(error)
    return info.value


def test_a_message_that_raises_is_no_trouble() -> None:
    """An error whose message cannot be made is named; without a plugin there is no line."""
    assert describe_error(caught(Mute())) == "Mute: its message raised RuntimeError"
    assert describe_error(caught(KeyError("nope"))) == "KeyError: 'nope'"
    assert describe_error(caught(KeyError())) == "KeyError"


def test_a_full_disk_is_found_behind_other_errors() -> None:
    """The error of a full disk is found where it led to another error; other errors of files are none."""
    full = OSError(errno.ENOSPC, "No space left on device")
    try:
        try:
            raise full
        except OSError:
            raise BadInput("cannot be written") from None
    except BadInput as error:
        assert storage_fault(error) is full
    assert storage_fault(OSError(errno.ENOENT, "No such file")) is None
    assert storage_fault(ValueError()) is None
