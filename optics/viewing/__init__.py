"""The eye's own optics and the surgeon's lenses between the microscope and the retina.

camera         The microscope behind a viewing path: from a wall point to its pixel and back
chebyshev      Chebyshev series: coefficients from values, and values with slopes
coaxial        How the microscope's coaxial light thins out on the wall behind a path
conic          Conic surfaces of revolution about the microscope's axis
data_file      Reads the files of eyes and viewing lenses
eye            Eyes: cornea, iris, crystalline lens and retina at one wavelength
eye_file       The format of eye files
magnification  What a pixel sees on the wall, and the local magnification there
medium         Media of one index, or with the gradient of a crystalline lens
path           Viewing paths: what lies between the microscope and the retina
pencil         The pencils of a microscope with a lens's pupil
reflex         Reflexes of a lamp at the surfaces of a path: Purkinje's images
side_camera    A pinhole beside the axis: one half of a stereo pair
trace          Rays traced from the microscope through a path into the eye
viewing_lens   Contact lenses and wide-field lenses
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
