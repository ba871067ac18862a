"""Blender's panel *posed* (sidebar of the 3-D view): connects to a daemon, shows bodies and sensors live, records them into actions, imports takes."""

import bpy
from bpy_extras.io_utils import ImportHelper

STEP_S = 1 / 60

# Of the running program, not of the file: there is one connection.
connection = None


class PosedSettings(bpy.types.PropertyGroup):
    address: bpy.props.StringProperty(name="Address", default="127.0.0.1:8787", description="HOST:PORT of the daemon, or the address of its page")
    token: bpy.props.StringProperty(name="Token", subtype="PASSWORD", options={"SKIP_SAVE"}, description="Where the daemon wants one")
    bodies: bpy.props.BoolProperty(name="Bodies", default=True, description="Each on an armature")
    sensors: bpy.props.BoolProperty(name="Sensors", default=True, description="Each on an empty")
    program: bpy.props.StringProperty(name="posed", subtype="FILE_PATH", description="The program, which makes the poses of a recording; empty: as PATH has it")


def tick():
    """Called by Blender's timer while there is a connection."""
    if connection is None:
        return None
    connection.step()
    return STEP_S


class POSED_OT_connect(bpy.types.Operator):
    bl_idname, bl_label, bl_description = "posed.connect", "Connect", "Shows what the daemon tracks, live"

    def execute(self, context):
        global connection
        import posed

        from .live import Live as Connection

        settings = context.scene.posed
        if connection is not None:
            connection.close()
        try:
            connection = Connection(settings.address, settings.token or None, settings.bodies, settings.sensors)
        except (posed.PosedError, ValueError) as error:
            connection = None
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if not bpy.app.timers.is_registered(tick):
            bpy.app.timers.register(tick)
        return {"FINISHED"}


class POSED_OT_disconnect(bpy.types.Operator):
    bl_idname, bl_label, bl_description = "posed.disconnect", "Disconnect", "Ends the connection; what was made stays"

    @classmethod
    def poll(cls, context):
        return connection is not None

    def execute(self, context):
        global connection
        connection.close()
        connection = None
        return {"FINISHED"}


class POSED_OT_record(bpy.types.Operator):
    bl_idname, bl_label, bl_description = "posed.record", "Record", "Records into actions, with keys at capture times; again: ends it"

    @classmethod
    def poll(cls, context):
        return connection is not None

    def execute(self, context):
        if connection.recorded is None:
            connection.record()
        else:
            made = connection.stop()
            self.report({"INFO"}, f"{len(made)} actions")
        return {"FINISHED"}


class POSED_OT_import_take(bpy.types.Operator, ImportHelper):
    bl_idname, bl_label, bl_description = "posed.import_take", "Import a take", "Makes armatures and empties of a recording of posed, with their actions"
    filename_ext = ".mcap"
    filter_glob: bpy.props.StringProperty(default="*.mcap", options={"HIDDEN"})

    def execute(self, context):
        import posed

        from .takes import load

        try:
            made = load(self.filepath, context.scene.posed.program or None)
        except (posed.PosedError, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{len(made)} objects")
        return {"FINISHED"}


class POSED_PT_panel(bpy.types.Panel):
    bl_idname, bl_label, bl_category, bl_space_type, bl_region_type = "POSED_PT_panel", "posed", "posed", "VIEW_3D", "UI"

    def draw(self, context):
        layout, settings = self.layout, context.scene.posed
        for name in ("address", "token", "bodies", "sensors"):
            layout.prop(settings, name)
        if connection is None:
            layout.operator("posed.connect")
        else:
            layout.label(text=f"{connection.stage.hello['stage']}: {'connected' if connection.stage.connected else 'connecting'}")
            layout.operator("posed.record", text="Record" if connection.recorded is None else "End recording")
            layout.operator("posed.disconnect")
        layout.prop(settings, "program")
        layout.operator("posed.import_take")


CLASSES = (PosedSettings, POSED_OT_connect, POSED_OT_disconnect, POSED_OT_record, POSED_OT_import_take, POSED_PT_panel)


def register():
    for one in CLASSES:
        bpy.utils.register_class(one)
    bpy.types.Scene.posed = bpy.props.PointerProperty(type=PosedSettings)


def unregister():
    global connection
    if connection is not None:
        connection.close()
        connection = None
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
    del bpy.types.Scene.posed
    for one in reversed(CLASSES):
        bpy.utils.unregister_class(one)
