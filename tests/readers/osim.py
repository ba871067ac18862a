"""OpenSim opens TRC, STO and MOT files: points, orientations and coordinates; its IMU placer and inverse kinematics work with them."""

import pathlib

import numpy as np
import opensim

from truth import FIFTEEN, FRAMES, MARKERS, ROOM, failures, held, matrices

opensim.Logger.setLevelString("error")
# From OpenSim's axes, ahead, up and right, to the room's.
FROM_OPENSIM = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
# Bodies of OpenSim's models that are bones of ours, from a joint to the next.
BONES = {"femur_r": ("thigh_r", "shank_r"), "femur_l": ("thigh_l", "shank_l"), "tibia_r": ("shank_r", "foot_r"), "tibia_l": ("shank_l", "foot_l"),
       "humerus_r": ("upper_arm_r", "forearm_r"), "humerus_l": ("upper_arm_l", "forearm_l"), "radius_r": ("forearm_r", "hand_r"), "radius_l": ("forearm_l", "hand_l")}


def files():
    """Points of TRC as OpenSim reads them; and the chain of bones that STO's orientations make, each as long and where it is in the truth."""
    table = opensim.TimeSeriesTableVec3("take.trc")
    points = {}
    for name in table.getColumnLabels():
        column = table.getDependentColumn(name)
        points[name] = np.array([[column[at][k] for k in range(3)] for at in FRAMES])
    held("take.trc", "OpenSim", points, MARKERS, FIFTEEN, FROM_OPENSIM)
    turned = opensim.TimeSeriesTableQuaternion("take.sto")
    labels = list(turned.getColumnLabels())
    rows = [turned.getRowAtIndex(at) for at in FRAMES]
    bones = {}
    for body, (above, below) in BONES.items():
        column = labels.index(f"{body}_imu")
        xyzw = np.array([[row.getElt(0, column).get(k) for k in (1, 2, 3, 0)] for row in rows])
        # OpenSim's axes of a body and ours are the same: the bone hangs along -y.
        length = np.linalg.norm(FIFTEEN[below] - FIFTEEN[above], axis=1).mean()
        bones[body] = FIFTEEN[above] + matrices(xyzw) @ [0, -length, 0] @ FROM_OPENSIM.T
    held("take.sto", "OpenSim", bones, {body: below for body, (_, below) in BONES.items()}, FIFTEEN, ROOM)


def person():
    """A model whose limbs are as long as the truth's, with the joints of OpenSim's whole bodies, and which joints its bodies begin at."""
    length = lambda a, b: float(np.linalg.norm(FIFTEEN[a] - FIFTEEN[b], axis=1).mean())
    middle = (FIFTEEN["upper_arm_r"] + FIFTEEN["upper_arm_l"]) / 2
    trunk = float(np.linalg.norm(middle - FIFTEEN["pelvis"], axis=1).mean())
    hip, shoulder = length("thigh_r", "thigh_l") / 2, length("upper_arm_r", "upper_arm_l") / 2
    model = opensim.Model()
    bodies = {"ground": model.getGround()}

    def hang(body, parent, at, turns, side=1, moves=("", "", "")):
        """By a joint that turns about z, x and y, on the left as in a mirror."""
        transform = opensim.SpatialTransform()
        axes = ((0, 0, 1), (side, 0, 0), (0, side, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))
        for index, (axis, name) in enumerate(zip(axes, (*turns, *moves))):
            part = getattr(transform, f"upd_{'rotation' if index < 3 else 'translation'}{index % 3 + 1}")()
            part.setAxis(opensim.Vec3(*axis))
            names = opensim.ArrayStr()
            if name:
                names.append(name)
            part.setCoordinateNames(names)
            # Knees of the whole bodies bend by positive angles.
            part.set_function(opensim.LinearFunction(-1 if name.startswith("knee") else 1, 0) if name else opensim.Constant(0))
        bodies[body] = opensim.Body(body, 1, opensim.Vec3(0), opensim.Inertia(1))
        zero = opensim.Vec3(0)
        model.addBody(bodies[body])
        model.addJoint(opensim.CustomJoint(f"{body}_joint", bodies[parent], opensim.Vec3(*at), zero, bodies[body], zero, zero, transform))

    hang("pelvis", "ground", (0, 0, 0), ("pelvis_tilt", "pelvis_list", "pelvis_rotation"), moves=("pelvis_tx", "pelvis_ty", "pelvis_tz"))
    hang("torso", "pelvis", (0, 0, 0), ("lumbar_extension", "lumbar_bending", "lumbar_rotation"))
    joints = {"pelvis": "pelvis"}
    for side, sign in (("r", 1), ("l", -1)):
        down = lambda above, below: (0, -length(f"{above}_{side}", f"{below}_{side}"), 0)
        for body, parent, at, turns, ours in (
            ("femur", "pelvis", (0, 0, sign * hip), ("hip_flexion", "hip_adduction", "hip_rotation"), "thigh"),
            ("tibia", "femur", down("thigh", "shank"), ("knee_angle", "", ""), "shank"),
            ("calcn", "tibia", down("shank", "foot"), ("ankle_angle", "", ""), "foot"),
            ("humerus", "torso", (0, trunk, sign * shoulder), ("arm_flex", "arm_add", "arm_rot"), "upper_arm"),
            ("ulna", "humerus", down("upper_arm", "forearm"), ("elbow_flex", "", ""), "forearm"),
            ("radius", "ulna", (0, 0, 0), ("", "", "pro_sup"), "forearm"),
            ("hand", "radius", down("forearm", "hand"), ("wrist_flex", "wrist_dev", ""), "hand"),
        ):
            hang(f"{body}_{side}", parent if parent in bodies else f"{parent}_{side}", at, [name and f"{name}_{side}" for name in turns], sign)
            joints[f"{body}_{side}"] = f"{ours}_{side}"
    model.finalizeConnections()
    return model, bodies, joints


def motion():
    """Joints of a model that is moved by the coordinates of MOT; and the coordinates that OpenSense finds by inverse kinematics from STO. Returns those of MOT."""
    model, bodies, joints = person()
    state = model.initSystem()
    table = opensim.TimeSeriesTable("take.mot")
    assert table.getTableMetaDataAsString("inDegrees") == "yes"
    # OpenSim knows by their names which coordinates are angles.
    model.getSimbodyEngine().convertDegreesToRadians(table)
    labels = list(table.getColumnLabels())
    coordinates = model.getCoordinateSet()
    assert sorted(labels) == sorted(coordinates.get(at).getName() for at in range(coordinates.getSize()))
    found = {body: [] for body in joints}
    for frame in FRAMES:
        row = table.getRowAtIndex(frame)
        for column, name in enumerate(labels):
            coordinates.get(name).setValue(state, row[column], False)
        model.realizePosition(state)
        for body, at in found.items():
            place = bodies[body].getPositionInGround(state)
            at.append([place.get(k) for k in range(3)])
    held("take.mot", "OpenSim", found, joints, FIFTEEN, FROM_OPENSIM)

    # Whoever stands with the thumbs ahead has forearms a quarter turn from the model's anatomical pose.
    for side in "rl":
        coordinates.get(f"pro_sup_{side}").setDefaultValue(np.pi / 2)
    model.printToXML("person.osim")
    header, rows = pathlib.Path("take.sto").read_text().split("endheader\n")
    names = rows.splitlines()[0].split("\t")
    n_pose = "\t".join(["0", *["1,0,0,0" for _ in names[1:]]])
    pathlib.Path("n-pose.sto").write_text("\n".join([header + "endheader", "\t".join(names), n_pose, ""]))
    placer = opensim.IMUPlacer()
    placer.set_model_file("person.osim")
    placer.set_orientation_file_for_calibration("n-pose.sto")
    placer.set_output_model_file("worn.osim")
    assert placer.run(False)
    times = [table.getIndependentColumn()[frame] for frame in FRAMES[-3:]]
    tool = opensim.IMUInverseKinematicsTool()
    tool.set_model_file("worn.osim")
    tool.set_orientations_file("take.sto")
    tool.set_time_range(0, times[0])
    tool.set_time_range(1, times[-1])
    tool.set_results_directory(".")
    tool.set_output_motion_file("opensense.mot")
    assert tool.run(False)
    solved = opensim.TimeSeriesTable("opensense.mot")
    off = {}
    for name in labels:
        # Orientations tell no places; a foot's inversion, which the model's ankle lacks, is shared out over the hip, knee and ankle.
        if not name.startswith("pelvis_t") or name == "pelvis_tilt":
            ours = np.degrees([table.getDependentColumn(name)[frame] for frame in FRAMES[-3:]])
            theirs = [solved.getDependentColumn(name)[solved.getNearestRowIndexForTime(t_s)] for t_s in times]
            off[name] = np.abs(ours - theirs).max()
    worst = max(off, key=off.get)
    print(f"OpenSense finds {len(off)} coordinates of take.mot from take.sto within {off[worst]:.2f} degrees ({worst})")
    if not off[worst] < 2.0:
        failures.append(f"OpenSense has {worst} {off[worst]:.1f} degrees elsewhere")
    return {name: np.degrees([table.getDependentColumn(name)[frame] for frame in FRAMES]) for name in labels}
