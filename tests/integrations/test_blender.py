"""The Blender add-on works in Blender's own Python, where bpy is installed; elsewhere it can be imported."""

from __future__ import annotations

import importlib.util
import sys
from types import ModuleType, SimpleNamespace

import pytest
from places import ROOT

ADD_ON = ROOT / "contrib" / "blender_import_cndhf.py"


def add_on() -> ModuleType:
    spec = importlib.util.spec_from_file_location("blender_import_cndhf", ADD_ON)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_in_blender(golden):
    bpy = pytest.importorskip("bpy")
    module = add_on()
    module.register()
    try:
        assert bpy.ops.import_mesh.cndhf(filepath=str(golden / "encoded.cndhf"), resolution=24) == {"FINISHED"}
        mesh = bpy.context.scene.objects["encoded"].data
        from cndhf_codec import load

        expected = load(golden / "encoded.cndhf").to_mesh(24)
        assert (len(mesh.vertices), len(mesh.polygons)) == (len(expected.vertices), len(expected.faces))
        assert not mesh.validate()  # True would say that something had to be repaired
        with pytest.raises(RuntimeError, match=r"README\.md: this is not a \.cndhf file"):
            bpy.ops.import_mesh.cndhf(filepath=str(ROOT / "README.md"))
    finally:
        module.unregister()


def test_importable_with_stand_ins(monkeypatch):
    if importlib.util.find_spec("bpy"):
        pytest.skip("bpy is installed: see above")
    any_property = lambda **_: None  # noqa: E731
    registered: list = []
    menu = SimpleNamespace(append=registered.append, remove=registered.remove)
    bpy, extras, io_utils = ModuleType("bpy"), ModuleType("bpy_extras"), ModuleType("bpy_extras.io_utils")
    bpy.types = SimpleNamespace(
        Operator=type("Operator", (), {}), OperatorFileListElement=object, TOPBAR_MT_file_import=menu
    )
    names = ("StringProperty", "CollectionProperty", "IntProperty", "BoolProperty")
    bpy.props = SimpleNamespace(**dict.fromkeys(names, any_property))
    bpy.utils = SimpleNamespace(register_class=registered.append, unregister_class=registered.remove)
    io_utils.ImportHelper = type("ImportHelper", (), {})
    for module in (bpy, extras, io_utils):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    module = add_on()
    module.register()
    assert registered == [module.ImportCndhf, module.menu]
    module.unregister()
    assert registered == []
