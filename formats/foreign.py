"""Files that people bring and eyespot does not read: what they are, and what to do with them."""

from pathlib import Path

LFS_POINTER = b"version https://git-lfs.github.com/spec/"
"""How a file begins that Git LFS has not fetched."""

_RAW = (
    "a camera's raw file, whose colours and black level only its converter knows. Convert it to "
    "TIFF with 16 bits, linear (darktable, RawTherapee, dcraw -4 -T)"
)
_PHONE = "an image as phones write it. Convert it to PNG (heif-convert, avifdec, ImageMagick)"
_KINDS = {
    **dict.fromkeys((".dng", ".nef", ".cr2", ".cr3", ".arw", ".raf", ".orf", ".rw2"), _RAW),
    **dict.fromkeys((".heic", ".heif", ".avif"), _PHONE),
    ".fits": 'a FITS file. Write its frames as an array: python -c "import numpy; from '
    "astropy.io import fits; numpy.save('frames.npy', fits.getdata('FILE'))\"",
    ".mat": 'a MATLAB file. Write its frames as an array: python -c "import numpy, scipy.io; '
    "numpy.save('frames.npy', scipy.io.loadmat('FILE')['NAME'])\"",
    ".czi": "a microscope's own file. Convert it to OME-TIFF (Bio-Formats, bfconvert)",
}
_KINDS |= {".fit": _KINDS[".fits"]}
_KINDS |= dict.fromkeys((".nd2", ".lif", ".vsi"), _KINDS[".czi"])
_BEGINNINGS = {b"SIMPLE  =": (0, ".fits"), b"ftypheic": (4, ".heic")}
"""Marks of files without a telling name, and where they stand."""


def what_it_is(path: Path) -> str | None:
    """What a file is and what to do, if it is one that is not read; None of others."""
    with path.open("rb") as file:
        head = file.read(256)
    if head.startswith(LFS_POINTER):
        return "a pointer of Git LFS, not the file itself. Fetch it: git lfs pull"
    for mark, (at, suffix) in _BEGINNINGS.items():
        if head[at : at + len(mark)] == mark:
            return _KINDS[suffix].replace("FILE", path.name)
    told = _KINDS.get(path.suffix.lower())
    return told.replace("FILE", path.name) if told else None
