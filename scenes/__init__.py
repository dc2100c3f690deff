"""Physically based image stacks with labels: Mitsuba 3 renders what `optics` describes.

settings     what a scene holds, validated; motion_settings, camera_settings: tables of it
scene_file   scenes as TOML, its template and JSON schema
geometry     the scene as optics objects
lens_light   the glue lens's light, kept on disk between runs
photometry   indirect light, exposure of the `paper` frames
motion       where the tip is at any moment, and the clocks that sample it
labels       the truth of every frame
check        refuses what cannot be rendered
fundus       the wall's picture, made from a seed; wall_image: from a file
build        the scene as a Mitsuba dictionary; wall: its largest part
plugins      emitters and integrator; sensor: the microscope (import after a variant is set)
images       one pose without noise; pixels: some of it; reach: which of them a pose changes
differentiable  photons with derivatives; smooth_lens: through the lens (likewise)
render       linear frames, sharp or gathered over an exposure
stacks       stacks on disk, rendered or exposed again
preview      one small frame
exposure     the camera: light to numbers; response, camera_output: its curve, mosaic and JPEG
variant      the one door to Mitsuba
llvm         finds a libLLVM that works
doctor       what a machine has and lacks
"""

from scenes.check import check_scene as check_scene
from scenes.motion import frame_count as frame_count
from scenes.preview import write_preview as write_preview
from scenes.render import LinearFrame as LinearFrame
from scenes.render import Renderer as Renderer
from scenes.scene_file import changed as changed
from scenes.scene_file import load_scene as load_scene
from scenes.scene_file import parsed_change as parsed_change
from scenes.scene_file import scene_schema as scene_schema
from scenes.scene_file import scene_template as scene_template
from scenes.scene_file import scene_toml as scene_toml
from scenes.settings import Scene as Scene
from scenes.settings import SceneError as SceneError
from scenes.stacks import expose_again as expose_again
from scenes.stacks import render_stack as render_stack
from scenes.variant import RendererUnavailable as RendererUnavailable
from scenes.variant import load_mitsuba as load_mitsuba
