"""The optional extension; everything else is in setup.cfg."""

from setuptools import Extension, setup

setup(ext_modules=[Extension("bulletuav.physics._batch", ["bulletuav/physics/_batch.c"], optional=True)])
