"""Counts an exercise aloud, and beeps after the fifth repetition: count_to_five.py STAGE"""

import sys

import posed

with posed.connect(sys.argv[1]) as stage:
    for event in stage.events("exercise"):
        if event["event"] == "counted":
            print(event["exercise"], event["count"], event.get("sentence") or "good", flush=True)
            if event["count"] == 5:
                print("\adone")
                break
