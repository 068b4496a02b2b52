"""Serves a simulated microscope that other programs control over a socket; see ``docs/serve.md``."""

from .microscope import Microscope
from .server import Client, Server

__all__ = ["Client", "Microscope", "Server"]
