"""Physically based image stacks with labels: Mitsuba 3 renders what `optics` describes.

settings     the scene file, validated
geometry     the scene as optics objects
photometry   indirect light, exposure of the `paper` frames
labels       the truth of every moment
fundus       the wall's picture, made from a seed
build        the scene as a Mitsuba dictionary
plugins      emitters and integrator (import after a variant is set)
render       linear frames; stacks on disk
exposure     the camera
variant      the one door to Mitsuba
llvm         finds a libLLVM that works
doctor       what a machine has and lacks
"""

from scenes.render import LinearFrame as LinearFrame
from scenes.render import Renderer as Renderer
from scenes.render import render_stack as render_stack
from scenes.settings import Scene as Scene
from scenes.settings import SceneError as SceneError
from scenes.settings import load_scene as load_scene
from scenes.settings import scene_template as scene_template
from scenes.settings import scene_toml as scene_toml
from scenes.variant import RendererUnavailable as RendererUnavailable
from scenes.variant import load_mitsuba as load_mitsuba
