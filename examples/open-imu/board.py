# An ESP32 or a Pico W with an MPU-6050 as a sensor of posed, in MicroPython: the open format as OSC over UDP, found by broadcast.
#
# Wiring: 3V3, GND, SDA to 21, SCL to 22, INT to 4. Write your network below, save as main.py, and name the board in the stage file:
#   [[device]]  name = "boards"  driver = "open-imu"  port = "udp://0.0.0.0:9301"  devices = ["mp-..."]   (it prints its identifier)
import socket
import struct
import time

import machine
import network

NETWORK, PASSWORD = "my network", "my password"
PORT = 9301  # OSC
MPU, SDA, SCL, READY = 0x68, 21, 22, 4
GYRO_RAD_S = 2000 / 32768 * 3.14159265 / 180
ACC_M_S2 = 8 / 32768 * 9.80665

DEVICE = "mp-" + "".join("%02x" % byte for byte in machine.unique_id()[-4:])
measured = []  # times of samples that are to be read, microseconds


def padded(text):
    data = text.encode()
    return data + bytes(4 - len(data) % 4)


def message(path, tags, data):
    return padded("/imu/1/%s/%s" % (DEVICE, path)) + padded("," + tags) + data


# The time of a sample is taken where the sensor says that it is there, not where it is read.
def on_ready(_):
    if not measured:
        measured.append(time.ticks_us())


def connect():
    wlan = network.WLAN(network.STA_IF)
    wlan.active(True)
    wlan.connect(NETWORK, PASSWORD)
    while not wlan.isconnected():
        time.sleep_ms(100)


def main():
    print(DEVICE)
    connect()
    bus = machine.I2C(0, sda=machine.Pin(SDA), scl=machine.Pin(SCL), freq=400000)
    # Awake with the clock of the gyro; 44 Hz low-pass; 1 kHz / 10; 2000 degrees/s; 8 g; INT when a sample is there.
    for register, value in ((0x6B, 1), (0x1A, 3), (0x19, 9), (0x1B, 0x18), (0x1C, 0x10), (0x38, 1)):
        bus.writeto_mem(MPU, register, bytes([value]))
    machine.Pin(READY, machine.Pin.IN).irq(on_ready, machine.Pin.IRQ_RISING)
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    udp.setsockopt(socket.SOL_SOCKET, 0x20, 1)  # broadcast
    udp.setblocking(False)
    server, found = "255.255.255.255", False
    number = 0
    # ticks_us() ends at 2^30: its steps add up to a clock that does not.
    last, t_us = time.ticks_us(), 0
    next_word = time.ticks_ms()
    while True:
        try:
            answer, peer = udp.recvfrom(64)
            if answer.startswith(b"IMU!1"):
                server, found = peer[0], True
        except OSError:
            pass
        if time.ticks_diff(time.ticks_ms(), next_word) >= 0:
            next_word = time.ticks_add(time.ticks_ms(), 5000 if found else 1000)
            # Times of 64 bits in microseconds.
            hello = padded("MicroPython") + padded("mpu6050 1") + struct.pack(">i", 100) + padded("us") + struct.pack(">i", 64)
            udp.sendto(message("hello", "ssisi", hello), (server, PORT))
            if not found:
                udp.sendto(b"IMU?1", (server, PORT))
        if not measured:
            time.sleep_ms(1)
            continue
        now = measured.pop()
        t_us += time.ticks_diff(now, last)
        last = now
        raw = struct.unpack(">7h", bus.readfrom_mem(MPU, 0x3B, 14))  # acceleration, temperature, angular velocity
        values = [word * GYRO_RAD_S for word in raw[4:]] + [word * ACC_M_S2 for word in raw[:3]]
        udp.sendto(message("0", "ihffffff", struct.pack(">iqffffff", number, t_us, *values)), (server, PORT))
        number = (number + 1) & 0x7FFFFFFF


main()
