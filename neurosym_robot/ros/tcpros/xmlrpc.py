"""The XML-RPC of ROS: calls to masters and nodes, and the server that every node has.

As https://wiki.ros.org/ROS/Master_API and https://wiki.ros.org/ROS/Slave_API say: each answer is
`[code, message, value]`, and code 1 means success. Bodies are bounded in both directions.
"""

import http.client
import xmlrpc.client
from collections.abc import Callable, Mapping
from typing import Any
from xml.parsers.expat import ExpatError
from xmlrpc.server import SimpleXMLRPCDispatcher, SimpleXMLRPCRequestHandler

from neurosym_robot.server import BoundedServer, deadline

__all__ = ["CallError", "Refused", "SlaveServer", "call"]

MAX_BODY = 4 << 20  # bytes; the state of a graph of thousands of topics stays below
TIMEOUT = 5.0  # seconds

# What Python's parsers raise at an answer that is none.
NONSENSE = (http.client.HTTPException, xmlrpc.client.Error, ExpatError, ValueError, TypeError)
NONSENSE += (LookupError, AttributeError, ArithmeticError)


class CallError(ConnectionError):
    """A call did not get through, or its answer is malformed."""


class Refused(CallError):
    """The call got through, and the answer was no."""


class _Transport(xmlrpc.client.Transport):
    accept_gzip_encoding = False

    def __init__(self, timeout: float):
        super().__init__()
        self._timeout = timeout

    def make_connection(self, host: Any) -> http.client.HTTPConnection:
        connection = super().make_connection(host)
        connection.timeout = self._timeout
        return connection

    def parse_response(self, response: Any) -> Any:
        body = response.read(MAX_BODY + 1)
        if len(body) > MAX_BODY:
            raise ValueError(f"the answer is longer than {MAX_BODY} bytes")
        return xmlrpc.client.loads(body)[0]


def call(uri: str, method: str, *arguments: Any, timeout: float = TIMEOUT) -> Any:
    """The answer of `method` of the node or master at `uri`.

    Raises:
        Refused: with the message, if the code is not 1.
        CallError: for no valid answer within `timeout` seconds.
    """
    try:
        with xmlrpc.client.ServerProxy(uri, transport=_Transport(timeout)) as proxy:
            code, message, value = getattr(proxy, method)(*arguments)  # pyright: ignore
    except OSError as error:
        # A host name that is not known here is helped by ROS_IP where the node runs.
        raise CallError(f"{uri!s:.80}: {error.strerror or error}") from None
    except NONSENSE as error:
        raise CallError(f"no answer of ROS to {method} ({error!s:.80})") from None
    if code != 1:
        raise Refused(str(message))
    return value


class _Handler(SimpleXMLRPCRequestHandler):
    timeout = TIMEOUT

    def handle_one_request(self) -> None:
        # The deadline is for the whole request, not for each byte.
        with deadline(self.connection, TIMEOUT):
            super().handle_one_request()

    def do_POST(self) -> None:
        length = self.headers.get("Content-Length", "")
        if not (length.isdecimal() and int(length[:9]) <= MAX_BODY):
            self.send_error(413)
        elif "Content-Encoding" in self.headers:
            self.send_error(501)
        else:
            super().do_POST()

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing: the graph asks often."""


class SlaveServer(BoundedServer, SimpleXMLRPCDispatcher):
    """Answers the calls in `methods`, which return values; code and message are added here."""

    # What the handler expects of its server.
    _send_traceback_header = logRequests = False

    def __init__(self, host: str, methods: Mapping[str, Callable[..., Any]]):
        """Bind to any free port of `host` and start."""
        SimpleXMLRPCDispatcher.__init__(self, allow_none=False, encoding="utf-8")
        BoundedServer.__init__(self, (host, 0), _Handler)
        self.methods = methods
        self.start()

    def _dispatch(self, method: str, params: Any) -> list[Any]:
        try:
            return [1, "", self.methods[method](*params)]
        except CallError as error:
            return [0, str(error), 0]
        except (KeyError, TypeError, ValueError):
            return [-1, f"no method or not the arguments of {method!s:.80}", 0]
