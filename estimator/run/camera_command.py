"""The command `eyespot camera`: measures a camera's noise, and writes it into a rig file."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from eyespot.estimator.run.options import OUT
from eyespot.formats.inputs import InputError


def camera(
    folder: Path,
    /,
    *,
    rig: Path,
    out: Annotated[Path, OUT],
    bayer: bool = False,
) -> None:
    """Measure a camera's noise from pairs of images of an even wall (EMVA 1288).

    Fixed focus, fixed gain, no gamma: a sheet of white paper out of focus, at five or more levels
    of light. The mode pixels needs the result.

    Args:
        folder: Images in pairs, in the order of their names: two of each brightness, and two in the
            dark.
        rig: Rig file that gets the camera's noise; camera.bit_depth is its own.
        out: The new rig file.
        bayer: Colours are interpolated behind a Bayer filter.
    """
    from eyespot.estimator.photon_transfer import measured_noise
    from eyespot.estimator.sources.files import open_images
    from eyespot.formats.inputs import in_file
    from eyespot.formats.rig import read_rig
    from eyespot.formats.whole_files import refuse_existing, write_text

    refuse_existing(out)
    known = read_rig(rig)
    view = known.view
    if view is not None and not view.response.is_straight:
        raise InputError(
            f"{rig}: photon transfer needs a linear response. Record raw frames with gamma 1, and "
            "set camera.response to linear."
        )
    images = [frame.image for frame in replace(open_images(folder), unrelated=False)]
    if len(images) % 2:
        raise InputError(
            f"{folder}: {len(images)} images make no pairs. Give two of each brightness, named so "
            "that they follow each other."
        )
    pairs = list(zip(images[::2], images[1::2], strict=True))
    with in_file(folder):
        found = measured_noise(pairs, bit_depth=known.camera.bit_depth, bayer=bayer)
    sheet = found.sheet
    write_text(out, known.with_noise(sheet).toml(out.parent))
    error = found.gain_sigma_dn_e / found.gain_dn_e
    print(
        f"{out}: {found.gain_dn_e:.4g} DN per electron (± {100 * error:.1f} %), full well "
        f"{sheet.full_well_e:.0f} e, read noise {sheet.read_noise_e:.1f} e, black level "
        f"{sheet.black_level_dn:.2f} DN, PRNU {100 * sheet.prnu:.2f} %; variances within "
        f"{100 * found.worst:.1f} % of a straight line, from {len(pairs)} pairs."
    )
