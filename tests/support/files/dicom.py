"""Recordings as DICOM files, written by pydicom."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian, MultiFrameTrueColorSecondaryCaptureImageStorage


def write_dicom(path: Path, images: Sequence[np.ndarray], kind: str = "") -> Path:
    """Frames every 40 ms; those of uint16 have 12 bits."""
    about = Dataset()
    about.file_meta = FileMetaDataset()
    about.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    about.SOPClassUID = MultiFrameTrueColorSecondaryCaptureImageStorage
    about.SOPInstanceUID = "1.2.3"
    about.FrameTime = 40.0
    frames = np.stack(images)
    usual = "RGB" if frames.ndim == 4 else "MONOCHROME2"
    about.set_pixel_data(frames, kind or usual, 12 if frames.dtype == np.uint16 else 8)
    about.save_as(path, enforce_file_format=True)
    return path
