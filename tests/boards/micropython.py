# Runs examples/open-imu/board.py for ten seconds on a computer: as much of MicroPython's modules as it uses. The sensor lies still with z up, and
# each datagram is a line of hexadecimal digits on the standard output.
import runpy
import socket
import sys
import time
import types

now_us = 1_071_740_000  # its 30 bits end after two seconds
handler = None


def sleep_ms(ms):
    global now_us
    for _ in range(ms):
        now_us += 1000
        if now_us % 10_000 == 0 and handler:
            handler(None)
    if now_us > 1_081_740_000:
        sys.exit()


class Pin:
    IN, IRQ_RISING = 0, 1

    def __init__(self, *_):
        pass

    def irq(self, on_ready, _):
        global handler
        handler = on_ready


class Bus:
    def __init__(self, *_, **__):
        pass

    def writeto_mem(self, *_):
        pass

    def readfrom_mem(self, *_):
        return bytes(4) + b"\x10\x00" + bytes(8)


class Network:
    def __init__(self, *_):
        pass

    active = connect = lambda self, *_: None

    def isconnected(self):
        return True


class Datagrams:
    pending = None

    def __init__(self, *_):
        pass

    setsockopt = setblocking = lambda self, *_: None

    def sendto(self, data, _):
        if data == b"IMU?1":
            self.pending = b"IMU!1 posed 0 9301 9301"
        print("datagram", data.hex())

    def recvfrom(self, _):
        if self.pending is None:
            raise OSError
        answer, self.pending = self.pending, None
        return answer, ("192.0.2.1", 9301)


PERIOD = 1 << 30
time.ticks_us = lambda: now_us % PERIOD
time.ticks_ms = lambda: now_us // 1000 % PERIOD
time.ticks_diff = lambda a, b: (a - b + PERIOD // 2) % PERIOD - PERIOD // 2
time.ticks_add = lambda a, b: (a + b) % PERIOD
time.sleep_ms = sleep_ms
socket.socket = Datagrams
sys.modules["machine"] = types.SimpleNamespace(Pin=Pin, I2C=Bus, unique_id=lambda: b"\x12\x34\x56\x78\xab\xcd")
sys.modules["network"] = types.SimpleNamespace(WLAN=Network, STA_IF=0)
runpy.run_path(sys.argv[1], run_name="__main__")
