"""Drops a file into a window from outside, as a file manager does: the protocol XDND of X11, spoken with nothing but libX11.

python drop_file.py FILE X Y     X, Y from the upper left of the screen; exit status 1 if nothing there takes it
"""

import ctypes
import sys
import time
from ctypes import POINTER, byref, c_char_p, c_int, c_long, c_ubyte, c_uint, c_ulong, c_void_p
from pathlib import Path

VERSION = 5
LIMIT_S = 20.0
CLIENT_MESSAGE, SELECTION_REQUEST, SELECTION_NOTIFY = 33, 30, 31
ANY_PROPERTY_TYPE, CURRENT_TIME, XA_ATOM = 0, 0, 4

FOUND = [POINTER(c_ulong), POINTER(c_int), POINTER(c_ulong), POINTER(c_ulong), POINTER(POINTER(c_ubyte))]
"""type, format, number of items, bytes left and the items of a property"""


class ClientMessage(ctypes.Structure):
    _fields_ = [
        ("type", c_int),
        ("serial", c_ulong),
        ("send_event", c_int),
        ("display", c_void_p),
        ("window", c_ulong),
        ("message_type", c_ulong),
        ("format", c_int),
        ("data", c_long * 5),
    ]


class SelectionRequest(ctypes.Structure):
    _fields_ = [
        ("type", c_int),
        ("serial", c_ulong),
        ("send_event", c_int),
        ("display", c_void_p),
        ("owner", c_ulong),
        ("requestor", c_ulong),
        ("selection", c_ulong),
        ("target", c_ulong),
        ("property", c_ulong),
        ("time", c_ulong),
    ]


class Selection(ctypes.Structure):
    """XSelectionEvent: what a request is answered with."""

    _fields_ = [
        ("type", c_int),
        ("serial", c_ulong),
        ("send_event", c_int),
        ("display", c_void_p),
        ("requestor", c_ulong),
        ("selection", c_ulong),
        ("target", c_ulong),
        ("property", c_ulong),
        ("time", c_ulong),
    ]


class Event(ctypes.Union):
    _fields_ = [
        ("type", c_int),
        ("client", ClientMessage),
        ("request", SelectionRequest),
        ("selection", Selection),
        ("padding", c_long * 24),
    ]


def load_x11() -> ctypes.CDLL:
    x11 = ctypes.CDLL("libX11.so.6")
    for name, result, arguments in (
        ("XOpenDisplay", c_void_p, [c_char_p]),
        ("XDefaultRootWindow", c_ulong, [c_void_p]),
        ("XInternAtom", c_ulong, [c_void_p, c_char_p, c_int]),
        ("XCreateSimpleWindow", c_ulong, [c_void_p, c_ulong, c_int, c_int, c_uint, c_uint, c_uint, c_ulong, c_ulong]),
        ("XSetSelectionOwner", c_int, [c_void_p, c_ulong, c_ulong, c_ulong]),
        ("XSendEvent", c_int, [c_void_p, c_ulong, c_int, c_long, POINTER(Event)]),
        ("XPending", c_int, [c_void_p]),
        ("XNextEvent", c_int, [c_void_p, POINTER(Event)]),
        ("XFlush", c_int, [c_void_p]),
        ("XFree", c_int, [c_void_p]),
        ("XChangeProperty", c_int, [c_void_p, c_ulong, c_ulong, c_ulong, c_int, c_int, c_char_p, c_int]),
        ("XTranslateCoordinates", c_int, [c_void_p, c_ulong, c_ulong, c_int, c_int, *[POINTER(c_int)] * 2, POINTER(c_ulong)]),
        ("XGetWindowProperty", c_int, [c_void_p, c_ulong, c_ulong, c_long, c_long, c_int, c_ulong, *FOUND]),
    ):
        function = getattr(x11, name)
        function.restype, function.argtypes = result, arguments
    return x11


class Source:
    def __init__(self, path: Path) -> None:
        self.x11 = load_x11()
        self.display = self.x11.XOpenDisplay(None)
        if not self.display:
            sys.exit("no X11 display")
        self.root = self.x11.XDefaultRootWindow(self.display)
        self.window = self.x11.XCreateSimpleWindow(self.display, self.root, 0, 0, 1, 1, 0, 0, 0)
        self.content = path.resolve().as_uri().encode() + b"\r\n"
        self.x11.XSetSelectionOwner(self.display, self.atom("XdndSelection"), self.window, CURRENT_TIME)

    def atom(self, name: str) -> int:
        return int(self.x11.XInternAtom(self.display, name.encode(), 0))

    def target_at(self, x: int, y: int) -> int:
        """The topmost window there that takes drops; 0: none."""
        found, window = 0, self.root
        while window:
            if self.takes_drops(window):
                found = window
            inside_x, inside_y, child = c_int(), c_int(), c_ulong()
            self.x11.XTranslateCoordinates(self.display, self.root, window, x, y, byref(inside_x), byref(inside_y), byref(child))
            window = child.value
        return found

    def takes_drops(self, window: int) -> bool:
        kind, form, count, left, data = c_ulong(), c_int(), c_ulong(), c_ulong(), POINTER(c_ubyte)()
        aware = self.atom("XdndAware")
        results = byref(kind), byref(form), byref(count), byref(left), byref(data)
        self.x11.XGetWindowProperty(self.display, window, aware, 0, 1, 0, ANY_PROPERTY_TYPE, *results)
        if data:
            self.x11.XFree(data)
        return bool(count.value)

    def send(self, target: int, message: str, *values: int) -> None:
        event = Event()
        event.client.type, event.client.window, event.client.message_type, event.client.format = (
            CLIENT_MESSAGE,
            target,
            self.atom(message),
            32,
        )
        event.client.data[:] = [self.window, *values, *[0] * (4 - len(values))]
        self.x11.XSendEvent(self.display, target, 0, 0, byref(event))
        self.x11.XFlush(self.display)

    def answer(self, request: SelectionRequest) -> None:
        """With the file's address."""
        self.x11.XChangeProperty(self.display, request.requestor, request.property, request.target, 8, 0, self.content, len(self.content))
        event = Event()
        event.selection.type, event.selection.requestor, event.selection.selection = SELECTION_NOTIFY, request.requestor, request.selection
        event.selection.target, event.selection.property, event.selection.time = request.target, request.property, request.time
        self.x11.XSendEvent(self.display, request.requestor, 0, 0, byref(event))
        self.x11.XFlush(self.display)

    def wait_for(self, message: str) -> ClientMessage:
        end, event, awaited = time.monotonic() + LIMIT_S, Event(), self.atom(message)
        while time.monotonic() < end:
            if not self.x11.XPending(self.display):
                time.sleep(0.01)
                continue
            self.x11.XNextEvent(self.display, byref(event))
            if event.type == SELECTION_REQUEST:
                self.answer(event.request)
            elif event.type == CLIENT_MESSAGE and event.client.message_type == awaited:
                return event.client
        sys.exit(f"no {message} within {LIMIT_S:.0f} s")

    def drop(self, x: int, y: int) -> None:
        target = self.target_at(x, y)
        if not target:
            sys.exit(f"nothing at {x}, {y} takes drops")
        copy = self.atom("XdndActionCopy")
        self.send(target, "XdndEnter", VERSION << 24, self.atom("text/uri-list"))
        for step in (4, 0):  # it comes from somewhere
            self.send(target, "XdndPosition", 0, (x - step) << 16 | y, CURRENT_TIME, copy)
            status = self.wait_for("XdndStatus")
        if not status.data[1] & 1:
            sys.exit("the window refuses the file")
        self.send(target, "XdndDrop", 0, CURRENT_TIME)
        self.wait_for("XdndFinished")


if __name__ == "__main__":
    Source(Path(sys.argv[1])).drop(int(sys.argv[2]), int(sys.argv[3]))
