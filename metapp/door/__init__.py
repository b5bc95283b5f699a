"""The door: what applications, rules, formats, commands and all else there is, shipped or of other packages.

An extension is a module that is cheap to import and defines OFFERS, a tuple of the records below: what a thing is
called, and "module:attribute" of what does the work, which `load` imports on first use. An entry point of the group
"metapp.extensions" names the module. What ships with metapp is found in the same way.
"""

from metapp.door.applications import Application as Application
from metapp.door.applications import Chosen as Chosen
from metapp.door.applications import Engine as Engine
from metapp.door.applications import Network as Network
from metapp.door.applications import Part as Part
from metapp.door.applications import Recipe as Recipe
from metapp.door.applications import Rule as Rule
from metapp.door.applications import recipes_in as recipes_in
from metapp.door.data import SPLIT as SPLIT
from metapp.door.data import Conversion as Conversion
from metapp.door.data import Converter as Converter
from metapp.door.data import Format as Format
from metapp.door.data import InMemory as InMemory
from metapp.door.data import Label as Label
from metapp.door.data import Merge as Merge
from metapp.door.data import SceneCheck as SceneCheck
from metapp.door.data import Synthetic as Synthetic
from metapp.door.data import label_of_stem as label_of_stem
from metapp.door.finding import GROUP as GROUP
from metapp.door.finding import WITHOUT as WITHOUT
from metapp.door.finding import Extension as Extension
from metapp.door.finding import extended as extended
from metapp.door.finding import extensions as extensions
from metapp.door.finding import left_out as left_out
from metapp.door.finding import load as load
from metapp.door.finding import module_of as module_of
from metapp.door.finding import offers as offers
from metapp.door.finding import offers_of as offers_of
from metapp.door.finding import problems as problems
from metapp.door.finding import switched_off as switched_off
from metapp.door.outputs import Baselines as Baselines
from metapp.door.outputs import Command as Command
from metapp.door.outputs import Export as Export
from metapp.door.outputs import FileExport as FileExport
from metapp.door.outputs import FitMethod as FitMethod
from metapp.door.outputs import Output as Output
from metapp.door.outputs import Page as Page
from metapp.door.outputs import PictureMeasure as PictureMeasure
from metapp.door.outputs import Plugin as Plugin
from metapp.door.outputs import Table as Table
