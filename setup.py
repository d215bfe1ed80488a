"""The wheel holds one package: ``config``, a folder of its own here, becomes ``companion.config``."""

from setuptools import find_packages, setup

setup(packages=[*find_packages(include=["companion*"]), "companion.config"], package_dir={"companion.config": "config"})
