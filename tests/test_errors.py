"""Errors that users meet: where, what and remedy."""

import os
import pickle

import pytest

from cddf_jax.errors import InputError, in_utf8, needed, within


def test_the_message_is_made_of_its_parts():
    error = InputError("is not a number", where="robot.toml: length", remedy="give a number")
    assert str(error) == "robot.toml: length: is not a number; give a number"
    assert str(InputError("wrong; do better")) == "wrong; do better"


def test_an_error_that_crosses_processes_keeps_its_message():
    error = pickle.loads(pickle.dumps(InputError("is wrong", where="a.csv", remedy="mend it")))
    assert str(error) == "a.csv: is wrong; mend it"


def test_a_place_is_put_before_others():
    with pytest.raises(InputError, match=r"^a\.csv: row 3: is wrong; mend it$"), within("a.csv"):
        raise InputError("is wrong", where="row 3", remedy="mend it")
    with pytest.raises(InputError, match=r"^a\.toml: two values$"), within("a.toml", ValueError):
        raise ValueError("two values")
    with pytest.raises(ValueError, match=r"^our own$"), within("a.toml"):
        raise ValueError("our own")


def test_file_names_that_are_not_utf8_are_shown_by_their_bytes():
    """0xff is no byte of UTF-8; 0xc3 0xa9 is e with an acute accent (RFC 3629)."""
    name = os.fsdecode(b"\xff\xc3\xa9.csv")
    assert in_utf8(name) == "\\xff\u00e9.csv"
    with pytest.raises(InputError, match=r"^\\xff\u00e9\.csv: is empty$"), within(name):
        raise InputError("is empty")


def test_a_missing_package_names_its_extra():
    with pytest.raises(InputError, match=r"needs no_such; install it with: pip install 'cddf-jax\[excel\]'"):
        needed("no_such", "excel")
