"""Exports in XML: Acoular's microphone geometry, ROS 2 static transforms, and URDF links."""

from __future__ import annotations

from xml.etree import ElementTree

from calib.export.heading import heading, printable
from calib.result_file import StoredCalibration

OPTICAL_FRAME = "camera_optical_frame"  # REP 103's name of our camera frame


def acoular_xml(array: StoredCalibration) -> bytes:
    """Return the geometry as `acoular.MicGeom(file=...)` reads it."""
    root = ElementTree.Element("MicArray", name=printable(array.session_names))
    for name, place_m in zip(array.names, array.positions_m, strict=True):
        x, y, z = (f"{value:.7f}" for value in place_m)
        ElementTree.SubElement(root, "pos", Name=name, x=x, y=y, z=z)
    return _document(array, root)


def ros2_launch_xml(array: StoredCalibration) -> bytes:
    """Return a launch file that publishes a static transform for each microphone."""
    root = ElementTree.Element("launch")
    ElementTree.SubElement(root, "arg", name="camera_frame", default=OPTICAL_FRAME)
    for name, place_m in zip(array.names, array.positions_m, strict=True):
        x, y, z = (f"{value:.7f}" for value in place_m)
        rotation = "--qx 0 --qy 0 --qz 0 --qw 1"
        frames = f"--frame-id $(var camera_frame) --child-frame-id {name}"
        ElementTree.SubElement(
            root,
            "node",
            pkg="tf2_ros",
            exec="static_transform_publisher",
            name=f"{name}_transform",
            args=f"--x {x} --y {y} --z {z} {rotation} {frames}",
        )
    return _document(array, root)


def urdf(array: StoredCalibration) -> bytes:
    """Return a robot of one link per microphone, fixed to the camera."""
    root = ElementTree.Element("robot", name="microphone_array")
    ElementTree.SubElement(root, "link", name=OPTICAL_FRAME)
    for name, place_m in zip(array.names, array.positions_m, strict=True):
        ElementTree.SubElement(root, "link", name=name)
        joint = ElementTree.SubElement(root, "joint", name=f"{name}_joint", type="fixed")
        ElementTree.SubElement(joint, "parent", link=OPTICAL_FRAME)
        ElementTree.SubElement(joint, "child", link=name)
        ElementTree.SubElement(joint, "origin", xyz=" ".join(f"{value:.7f}" for value in place_m), rpy="0 0 0")
    return _document(array, root)


def _document(array: StoredCalibration, root: ElementTree.Element) -> bytes:
    ElementTree.indent(root)
    comment = "\n".join(heading(array)).replace("--", "- -")  # a comment of XML cannot hold two hyphens
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="utf-8"?>\n<!--\n{comment}\n-->\n{text}\n'.encode()
