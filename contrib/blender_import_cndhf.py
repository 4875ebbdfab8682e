"""Blender add-on: File > Import > CN-DHF (.cndhf).

Blender brings its own Python, which needs this package once:
    <blender>/<version>/python/bin/python3 -m pip install '<checkout>[mesh]'
Then Edit > Preferences > Add-ons > Install from Disk, and name this file. Coordinates come in as they are in the file.
"""

from pathlib import Path

import bpy
from bpy_extras.io_utils import ImportHelper

bl_info = {
    "name": "CN-DHF meshes (.cndhf)",
    "author": "cndhf-codec",
    "version": (0, 1, 0),
    "blender": (4, 2, 0),
    "location": "File > Import > CN-DHF (.cndhf)",
    "description": "Import meshes stored as neural double height fields",
    "category": "Import-Export",
}


def import_cndhf(path, resolution=256, smooth=True):
    """A new object in the active collection, of the surface of a `.cndhf` file. Raises cndhf_codec.CndhfError."""
    import cndhf_codec  # here: the add-on can be switched on, and say what is missing, without the package

    model = cndhf_codec.load(path)
    # A surface has no resolution: its default mesh is as fine as the file's error asks for.
    surface = model.to_mesh(resolution) if model.representation == "dhf" else model.to_mesh()
    mesh = bpy.data.meshes.new(Path(path).stem)
    mesh.from_pydata(surface.vertices, [], surface.faces)
    mesh.polygons.foreach_set("use_smooth", [smooth] * len(mesh.polygons))
    mesh.update()
    item = bpy.data.objects.new(mesh.name, mesh)
    bpy.context.collection.objects.link(item)
    return item


class ImportCndhf(bpy.types.Operator, ImportHelper):
    bl_idname = "import_mesh.cndhf"
    bl_label = "Import CN-DHF"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender reads a plain set

    filename_ext = ".cndhf"
    filter_glob: bpy.props.StringProperty(default="*.cndhf", options={"HIDDEN"})
    files: bpy.props.CollectionProperty(type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"})
    resolution: bpy.props.IntProperty(
        name="Resolution", description="Grid cells along the longest side", default=256, min=8, max=2048
    )
    smooth: bpy.props.BoolProperty(name="Smooth shading", default=True)

    def execute(self, context):
        folder = Path(self.filepath).parent
        paths = [folder / file.name for file in self.files if file.name] or [Path(self.filepath)]
        try:
            import cndhf_codec
        except ImportError:
            self.report({"ERROR"}, "Blender's Python lacks cndhf-codec; run its pip install '<checkout>[mesh]'")
            return {"CANCELLED"}
        try:
            for path in paths:
                import_cndhf(path, self.resolution, self.smooth)
        except cndhf_codec.CndhfError as exc:
            self.report({"ERROR"}, str(exc))
            return {"CANCELLED"}
        return {"FINISHED"}


def menu(self, context):
    self.layout.operator(ImportCndhf.bl_idname, text="CN-DHF (.cndhf)")


def register():
    bpy.utils.register_class(ImportCndhf)
    bpy.types.TOPBAR_MT_file_import.append(menu)


def unregister():
    bpy.types.TOPBAR_MT_file_import.remove(menu)
    bpy.utils.unregister_class(ImportCndhf)


if __name__ == "__main__":
    register()
