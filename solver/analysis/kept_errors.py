"""Numerical errors of runs, kept on disk for who simulates the same later and has no time for a twin: the node.

An error is kept under what it depends on: the model, its start, its maneuver and what acts behind it, and the settings
of the integrator; and the sources of the solver, so none is ever out of date. How steps that fail are divided does not
count: where none failed, as in a run that was measured, it makes no difference.
"""

from __future__ import annotations

import dataclasses
import json
from contextlib import suppress
from typing import Any

from solver.disk import Store, digest, sources, store_of
from solver.scene import Scene

NONE = 'not measured: mbd run SCENE, with the overrides of this node, measures it'
DIVIDED = ('auto', 'constant', 'rescue')  # policies that divide no step but one that fails


def keep(scene: Scene, text: str) -> None:
    """Keep the sentence on the error of a run of a whole scene, as it was simulated; without effect where nothing can
    be written."""
    store, name = _place(scene)
    with suppress(OSError):
        store.write(name, json.dumps({'text': text, 'duration': scene.duration, 'scene': scene.name}).encode())


def kept(scene: Scene) -> str:
    """Sentence on the error of this scene, as it was measured at another time."""
    store, name = _place(scene)
    content = store.read(name)
    if content is None:
        return NONE
    found: dict[str, Any] = json.loads(content)
    return f'{found["text"]} (measured by mbd run {found["scene"]}, {found["duration"]:g} s of its maneuver)'


def _place(scene: Scene) -> tuple[Store, str]:
    settings = scene.integrator
    if settings.step_policy in DIVIDED:
        settings = dataclasses.replace(settings, step_policy='auto')
    parts = (scene.model, scene.start, scene.maneuver, scene.actuation, scene.assistance, settings)
    return store_of('errors'), f'{digest(sources(), *map(repr, parts)).hex()}.json'
