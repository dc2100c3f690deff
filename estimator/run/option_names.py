"""How options are written on the command line, and where those of older versions went."""


def option(name: str) -> str:
    """How a field is written on the command line."""
    return f"--{name.replace('_', '-')}"


MOVED = {
    "microscope": "microscope.calibration",
    "pinhole_height_mm": "microscope.pinhole_height_mm",
    "eye_radius_mm": "wall.radius_mm",
    "wall": "wall.kind",
    "phantom": "wall.kind",
    "medium": "wall.medium",
    "full_scale": "camera.full_scale",
    "fibre_diameter_mm": "instrument.fibre_diameter_mm",
    "eye_from_robot": "robot.eye_from_robot",
    "image_topic": "robot.image_topic",
    "pose_topic": "robot.pose_topic",
    "stated": "robot, wall, viewing and unrest",
}
"""Options of eyespot 0.1 and 0.2, and the keys of the rig file that replace them."""


def moved(name: str) -> str | None:
    """What to say of an option that is a key of the rig file now; None of any other."""
    key = MOVED.get(name)
    if key is None:
        return None
    if name == "microscope":
        return "--microscope is --rig: a microscope.json or a camera file is taken there as well."
    if name == "stated":
        return "--stated is --rig: a file of stated uncertainties is taken there as well."
    return (
        f"{option(name)} is the key {key} of the rig file. Write it there (--rig FILE; `eyespot "
        f"rig init` gives one), or give --set {key}=VALUE."
    )
