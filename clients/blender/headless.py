"""Blender without a window, against a running `posed demo`: live, recorded, imported. POSED_TEST_STAGE, POSED and a recording are given.

    python clients/blender/headless.py take.mcap

With Blender as a module, and the Python client beside it. Ends with 1 where a bone or an empty is not where the daemon says.
"""

import os
import pathlib
import sys
import time
import traceback

import bpy  # isort: skip: it brings the others
import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import posed  # noqa: E402
import posed_blender  # noqa: E402
from posed_blender import actions  # noqa: E402

# As exact as Blender, whose numbers are single ones through a chain of bones.
NEAR_M = 1e-4


def heads(armature):
    bpy.context.view_layer.update()
    return {bone.name: np.array(armature.matrix_world @ bone.head) for bone in armature.pose.bones}


def held(found, segments, position_m, why):
    for at, segment in enumerate(segments):
        if np.isfinite(position_m[at]).all():
            off_m = np.linalg.norm(found[segment] - position_m[at])
            assert off_m < NEAR_M, f"{why}: {segment} is {off_m:.5f} m off"


def shown_at(t_s, from_s):
    frame = float(actions.frames_of([t_s], from_s)[0])
    bpy.context.scene.frame_set(int(np.floor(frame)), subframe=frame - np.floor(frame))


def recorded_live():
    bpy.context.scene.posed.address = os.environ["POSED_TEST_STAGE"]
    assert bpy.ops.posed.connect() == {"FINISHED"}
    live = posed_blender.connection
    until = time.monotonic() + 60
    while not (live.skeletons and "wand" in live.empties):
        assert time.monotonic() < until, "no body, or no wand"
        live.step()
    bpy.ops.posed.record()
    while len(live.recorded.get("person", [])) < 100 or len(live.recorded.get(None, [])) < 100:
        assert time.monotonic() < until, "no frames"
        live.step()
        time.sleep(0.01)
    frames, sensors = list(live.recorded["person"]), list(live.recorded[None])
    armature = live.skeletons["person"].object
    held(heads(armature), frames[-1].segments, frames[-1].position_m, "live")
    # A hinge bends the bone, and an orientation is the segment's: the forearm points to the hand.
    forearm = armature.pose.bones["forearm_r"]
    hand_m = frames[-1].position_m[frames[-1].index("hand_r")]
    assert np.linalg.norm(np.array(armature.matrix_world @ forearm.tail) - hand_m) < 5e-3, "the forearm does not point to the hand"
    bpy.ops.posed.record()
    from_s = min(frames[0].t_s, sensors[0].t_s)
    for frame in frames[:: len(frames) // 10]:
        shown_at(frame.t_s, from_s)
        held(heads(armature), frame.segments, frame.position_m, f"recorded at {frame.t_s} s")
    wand = live.empties["wand"]
    good = [frame for frame in sensors if frame.usable[frame.index("wand")]]
    for frame in good[:: max(len(good) // 10, 1)]:
        shown_at(frame.t_s, from_s)
        at = frame.index("wand")
        assert np.linalg.norm(np.array(wand.location) - frame.position_m[at]) < NEAR_M
        assert abs(abs(np.dot(wand.rotation_quaternion, frame.q_room_sensor_wxyz[at])) - 1) < 1e-5
    assert bpy.ops.posed.disconnect() == {"FINISHED"}
    return len(frames), len(good)


def imported(path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    began = time.perf_counter()
    assert bpy.ops.posed.import_take(filepath=str(path)) == {"FINISHED"}
    took_s = time.perf_counter() - began
    body = posed.read(path, frames="numpy").body
    armature = bpy.data.objects["person"]
    segments = [name.removesuffix("_state") for name in body if name.endswith("_state")]
    from_s = min(body["t_s"][0], posed.read(path, frames="numpy").sensors["t_s"][0])
    compared = 0
    for row in range(0, len(body["t_s"]), max(len(body["t_s"]) // 10, 1)):
        position_m = np.array([[body[f"{segment}_{axis}_m"][row] for axis in "xyz"] for segment in segments], dtype=float)
        if np.isfinite(position_m).all():
            shown_at(body["t_s"][row], from_s)
            held(heads(armature), segments, position_m, f"imported at {body['t_s'][row]} s")
            compared += 1
    assert compared > 2 and "wand" in bpy.data.objects
    return compared, took_s


def main():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    posed_blender.register()
    bodies, wands = recorded_live()
    compared, took_s = imported(pathlib.Path(sys.argv[1]).resolve())
    posed_blender.unregister()
    print(f"Blender {bpy.app.version_string}: {bodies} frames of a body and {wands} of a sensor recorded, {compared} of a take compared, imported in {took_s:.1f} s")


# Blender as a module does not always come to its end when Python does: it is not waited for.
ended = 1
try:
    main()
    ended = 0
except BaseException:
    traceback.print_exc()
finally:
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(ended)
