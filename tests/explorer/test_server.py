"""What the server of the page tells of errors."""

import asyncio

import pytest

pytest.importorskip("panel")
from tornado.websocket import WebSocketClosedError

from cddf_jax.explorer.server import tell_unless_closed


@pytest.mark.parametrize(("error", "told"), [(WebSocketClosedError(), False), (ValueError("a defect"), True)])
def test_a_page_closed_while_it_is_computed_is_no_error(caplog, error, told):
    loop = asyncio.new_event_loop()
    loop.set_exception_handler(tell_unless_closed)
    loop.call_exception_handler({"message": "in a task", "exception": error})
    loop.close()
    assert ("a defect" in caplog.text) == told
