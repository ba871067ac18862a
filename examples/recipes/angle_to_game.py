"""Sends an elbow's angle to a game, as a number from 0 (straight) to 1 (bent) by UDP, 30 times a second: angle_to_game.py STAGE GAME_HOST:PORT"""

import socket
import sys

import numpy as np

import posed

STRAIGHT_DEG, BENT_DEG = 10, 130

host, port = sys.argv[2].rsplit(":", 1)
game = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
with posed.connect(sys.argv[1]) as stage:
    try:
        for body in stage.body(max_rate_hz=30):
            angle_deg = body.angles_deg["elbow_r_flexion"]
            # What no sensor shows is not a number: the game keeps what it has.
            if np.isfinite(angle_deg):
                value = np.clip((angle_deg - STRAIGHT_DEG) / (BENT_DEG - STRAIGHT_DEG), 0, 1)
                game.sendto(f"{value:.3f}".encode(), (host, int(port)))
    except posed.Disconnected as over:
        print(over)
