"""The page's server: the standard library's, for this machine only.

Any web site can make a browser send requests to this machine. So every address begins with a secret
word, a request must name this server as its host and its own page as its origin, and no path of a
request is a path on the disk.
"""

import json
import queue
import secrets
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from evaluation.replay import DRAWING
from support.runs import RunError

PAGE = Path(__file__).with_name("page.html")
MOST_BYTES = 10 ** 6  # in a request, enough for a room's file
MOST_PAGES = 4  # open at the same time: a browser allows six connections to a server
TOO_MANY = "This page is off, because others were opened. Reload it to continue."
ALIVE = 10.0  # [s] between two signs of life to a page, which show whether it is still open
HEADERS = {"Cache-Control": "no-store", "Referrer-Policy": "no-referrer",
           "X-Content-Type-Options": "nosniff", "Cross-Origin-Resource-Policy": "same-origin",
           "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; "
                                      "style-src 'unsafe-inline'; img-src data:; "
                                      "connect-src 'self'; frame-ancestors 'none'"}


class Feed:
    """The content of open pages, and their requests. A thread that drives calls `publish` and
    `next_request`; each page has threads that call `follow` and `ask`."""

    def __init__(self):
        self._requests = queue.Queue()  # (request, queue for its answer)
        self.pages = []  # one object per open page, the oldest first
        self._texts = {}  # part of the page -> its newest content as JSON
        self._changed = threading.Condition()

    def publish(self, **parts):
        """Sends parts of the page, each a value for JSON, to all open pages."""
        with self._changed:
            self._texts |= {name: json.dumps(value) for name, value in parts.items()}
            self._changed.notify_all()

    def follow(self):
        """Yields the text of server-sent events for one page: each part when it has changed. Slow
        pages skip what is old. Ends if too many pages are open."""
        page = object()
        sent = {}
        with self._changed:
            self.pages.append(page)
            del self.pages[:-MOST_PAGES]
            self._changed.notify_all()
        # Wakes the thread that drives, and releases keys that a page held when it crashed.
        self._requests.put(({"keys": []}, queue.SimpleQueue()))
        try:
            while True:
                with self._changed:
                    self._changed.wait_for(
                        lambda: sent != self._texts or page not in self.pages, ALIVE)
                    is_open = page in self.pages
                    new = {name: text for name, text in self._texts.items()
                           if sent.get(name) != text}
                    sent = dict(self._texts)
                # Not while holding the lock: a page that does not read would stop all others.
                if not is_open:
                    yield f"event: end\ndata: {json.dumps(TOO_MANY)}\n\n"
                    return
                yield "".join(f"event: {name}\ndata: {text}\n\n"
                              for name, text in new.items()) or ": alive\n\n"
        finally:
            with self._changed:
                if page in self.pages:
                    self.pages.remove(page)

    def ask(self, request):
        """Waits until a request (a dict) is answered. Returns what is wrong with it, or ''."""
        answer = queue.SimpleQueue()
        self._requests.put((request, answer))
        return answer.get()

    def next_request(self, seconds):
        """Waits for the next request, for a time or, if it is None, without limit. Returns it and
        the queue for its answer, or None."""
        try:
            return self._requests.get(timeout=seconds)
        except queue.Empty:
            return None


class Handler(BaseHTTPRequestHandler):
    """Answers one connection of a browser. `server` is a Server."""

    protocol_version = "HTTP/1.1"
    timeout = 60  # [s] without a byte from the browser
    disable_nagle_algorithm = True

    def log_message(self, *_):
        """Prints nothing."""

    def do_GET(self):
        name = self._requested()
        if name == "":
            self._answer(200, self.server.page(), "text/html; charset=utf-8")
        elif name == "events":
            self._stream()
        else:
            self._answer(404)

    def do_POST(self):
        if self._requested() != "do":
            return self._answer(404)
        size = self.headers.get("Content-Length", "")
        if self.headers.get("Content-Type") != "application/json" or not size.isdecimal():
            return self._answer(415)
        if len(size) > 9 or int(size) > MOST_BYTES:
            return self._answer(413)
        try:
            request = json.loads(self.rfile.read(int(size)), parse_constant=refuse)
        except (ValueError, RecursionError):
            request = None
        if not isinstance(request, dict):
            return self._answer(400)
        # The answer comes when the request is done, so a page cannot run ahead of the robot.
        return self._answer(200, self.server.feed.ask(request).encode(),
                            "text/plain; charset=utf-8")

    def _requested(self):
        """Returns the part of the path after the secret word, or None for a foreign request."""
        host = self.headers.get("Host", "")
        own = host.rpartition(":")[0] in ("127.0.0.1", "localhost")  # any port, for `ssh -L`
        if not own or self.headers.get("Origin") not in (None, f"http://{host}"):
            return None
        root = self.server.root
        return self.path.removeprefix(root) if self.path.startswith(root) else None

    def _answer(self, status, body=b"refused", kind="text/plain"):
        """Sends a whole answer. After an error the connection is closed: its body is unread."""
        self._begin(status, {"Content-Type": kind, "Content-Length": str(len(body))}
                    | ({"Connection": "close"} if status >= 400 else {}))
        self.wfile.write(body)

    def _begin(self, status, headers):
        """Sends the head of an answer."""
        self.send_response(status)
        for name, value in (HEADERS | headers).items():
            self.send_header(name, value)
        self.end_headers()

    def _stream(self):
        """Sends server-sent events until the page is closed."""
        self._begin(200, {"Content-Type": "text/event-stream", "Connection": "close"})
        events = self.server.feed.follow()
        try:
            for text in events:
                self.wfile.write(text.encode())
        except OSError:
            pass  # the page was closed
        finally:
            events.close()


def refuse(constant):
    """Raises ValueError for NaN and Infinity, which are not JSON."""
    raise ValueError(constant)


class Server(ThreadingHTTPServer):
    """Serves the page of one Feed."""

    daemon_threads = True

    def __init__(self, feed, port, lists):
        """port: 0 for any free one. lists: a function that returns values for a new page, such as
        the names of rooms. Raises RunError."""
        try:
            super().__init__(("127.0.0.1", port), Handler)
        except OSError as error:
            raise RunError(f"--port {port} cannot be used: {error.strerror}") from None
        self.feed = feed
        self.lists = lists
        self.root = f"/{secrets.token_urlsafe(12)}/"
        self.address = f"http://127.0.0.1:{self.server_port}{self.root}"

    def page(self):
        """Returns the page as bytes."""
        page = PAGE.read_text(encoding="utf-8")
        page = page.replace("DRAWING", DRAWING.read_text(encoding="utf-8"), 1)
        return page.replace("LISTS", json.dumps(self.lists()).replace("<", "\\u003c"), 1).encode()

    def handle_error(self, request, client_address):
        """Prints an error, unless the browser has closed the connection."""
        if not isinstance(sys.exc_info()[1], OSError):
            super().handle_error(request, client_address)
