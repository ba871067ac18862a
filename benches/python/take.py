"""How long the Python client takes to read a recording: the first time, and once its columns are kept.

    pip install './clients/python[pandas,polars]'
    python benches/python/take.py take.mcap target/release/posed

Each of the repeated reads is a process of its own, from its first line to the data frame; the import of pandas is told apart.
"""

import argparse
import json
import subprocess
import sys
import time

import posed

ONCE = """
import sys, time
began = time.perf_counter()
import {frames}
imported = time.perf_counter()
import posed
frame = posed.read(sys.argv[1], frames="{frames}").{table}
ended = time.perf_counter()
print(ended - imported, imported - began, *frame.shape)
"""


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording")
    parser.add_argument("posed", help="the program")
    options = parser.parse_args()
    began = time.perf_counter()
    posed.read(options.recording, program=options.posed, keep=False)
    print(json.dumps({"read": "first", "s": round(time.perf_counter() - began, 2)}), flush=True)
    posed.read(options.recording, program=options.posed)
    for frames in ("pandas", "polars"):
        for table in ("body", "sensors", "measured", "events"):
            times = []
            for _ in range(5):
                code = ONCE.format(frames=frames, table=table)
                done = subprocess.run([sys.executable, "-c", code, options.recording], check=True, capture_output=True, text=True)
                times.append([float(word) for word in done.stdout.split()])
            took, library, rows, columns = sorted(times)[2]
            told = {"read": "kept", "frames": frames, "table": table, "rows": int(rows), "columns": int(columns)}
            print(json.dumps({**told, "s": round(took, 3), "library_s": round(library, 2)}), flush=True)


main()
