"""Processes that work for a command: they come from one that has imported once what all of them need."""

import multiprocessing
from multiprocessing.context import ForkServerContext


def children(needs: str) -> ForkServerContext:
    """The context to make such processes in.

    They are forked from a server that imports the module `needs` and does nothing else, so that a child begins at once
    and its imports are in memory once; neither CUDA nor OpenGL, which do not survive a fork, is awake in the server.

    Args:
        needs: Dotted name of a module; it is imported in the server only, at the first process of this program.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([needs])
    return context
