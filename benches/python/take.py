"""How long the Python client takes from a recording to a data frame.

    pip install './clients/python[pandas,polars]'
    python benches/python/take.py take.mcap
    python benches/python/take.py take.mcap --replay target/release/posed

Each read is a process of its own, from the import of the client to the data frame; the import of pandas or polars is reported apart. Medians of five, with the processor time beside them.
`--replay` reads it as one without columns is read, too: by a replay with this program.
"""

import argparse
import json
import os
import subprocess
import sys
import time

import posed

ONCE = """
import sys, time
began = time.perf_counter()
import {frames}
imported, used = time.perf_counter(), time.process_time()
import posed
frame = posed.read(sys.argv[1], frames="{frames}").{table}
print(time.perf_counter() - imported, time.process_time() - used, imported - began, *frame.shape)
"""


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording")
    parser.add_argument("--replay", metavar="POSED", help="the program")
    options = parser.parse_args()
    if options.replay:
        began, before = time.perf_counter(), os.times()
        posed.read(options.recording, program=options.replay, keep=False, replay=True)
        after = os.times()
        program, reader = (round(sum(getattr(after, one) - getattr(before, one) for one in kind), 1) for kind in (("children_user", "children_system"), ("user", "system")))
        print(json.dumps({"read": "replay", "s": round(time.perf_counter() - began, 1), "program_cpu_s": program, "reader_cpu_s": reader}), flush=True)
    for frames in ("pandas", "polars"):
        for table in ("body", "sensors", "measured", "events"):
            times = []
            for _ in range(5):
                done = subprocess.run([sys.executable, "-c", ONCE.format(frames=frames, table=table), options.recording], check=True, capture_output=True, text=True)
                times.append([float(word) for word in done.stdout.split()])
            took, used, library, rows, columns = sorted(times)[2]
            report = {"frames": frames, "table": table, "rows": int(rows), "columns": int(columns)}
            print(json.dumps({**report, "s": round(took, 3), "cpu_s": round(used, 3), "library_s": round(library, 2)}), flush=True)


main()
