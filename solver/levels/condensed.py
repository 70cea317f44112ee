"""The level `condensed`: fewer bodies for the same mechanism, by rules that keep mass, geometry, stiffness and damping.

    merging  what is joined rigidly, or by bushings so stiff that no scene feels them, is one body
    mounts   equal bushings between two bodies are one
    shafts   half shafts and propeller shafts are coordinates and inertias
    columns  so are steering columns
    struts   a coil-over is spring and damper in a row with its mount
    bars     an anti-roll bar is a spring over the difference of its drop links
    rods     links and arms are massless rods with the stiffness of their bushings in series

What moves on soft rubber stays (engine, subframes), and so do bodies that carry more than their ends.
`condensed(model)` is a function of a ModelSpec; a mechanism in which no rule finds anything comes back as it is.
"""

from __future__ import annotations

import dataclasses

from solver.findings import LevelReport, Limit
from solver.levels.bars import reduced_bars
from solver.levels.carried import require_kept
from solver.levels.columns import reduced_columns
from solver.levels.derived import Derived, with_one_iteration
from solver.levels.draft import Draft
from solver.levels.merging import merge_fixed, merge_stiff
from solver.levels.mounts import joined_mounts
from solver.levels.reactions import without_angles
from solver.levels.rods import massless_links
from solver.levels.shafts import reduced_shafts
from solver.levels.struts import reduced_struts
from solver.model.spec import ModelSpec
from solver.remembered import of_same
from solver.scene import Scene

STIFF = 40.0  # Hz on its mounts, from which on a body that carries no load but its own moves with what it is mounted to


@of_same
def condensed(model: ModelSpec, *, stiff: float = STIFF) -> tuple[ModelSpec, tuple[str, ...]]:
    """(a model with fewer bodies, what it does not show in words). stiff: lowest natural frequency of a body that is
    merged [Hz]."""
    draft = Draft(model)
    merge_fixed(draft)
    merge_stiff(draft, stiff)
    joined_mounts(draft)
    reduced_shafts(draft)
    reduced_columns(draft)
    reduced_struts(draft)
    reduced_bars(draft)
    massless_links(draft)
    less = draft.model()
    return less, (*draft.lost, *require_kept(less, model))


def derive(scene: Scene) -> Derived:
    """The level `condensed` of a scene."""
    model, lost = condensed(scene.model)
    validity = (
        Limit(quantity='frequency', unit='Hz', high=30.0, why='links, arms and shafts have no modes of their own'),
    )
    report = LevelReport(lost=(*lost, *without_angles(scene.model)), validity=validity)
    derived = dataclasses.replace(scene, model=model, integrator=with_one_iteration(scene.integrator))
    return Derived(scene=derived, level='condensed', report=report)
