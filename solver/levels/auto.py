"""`fidelity: auto`: level, switches and integrator that the plan of a scene has chosen (`mbd plan`), and its
certificate: the envelope, and what would make a run suspect but was there too where errors were measured.

A plan is kept beside the compiled kernels under what it depends on: the model, the start, the maneuver (of a recording
its inputs), the actuators and the assistance behind it, the duration, what is required, and the sources of the solver.
So it cannot be out of date: whatever changes, there is none any more.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, NamedTuple

from solver.disk import Store, digest, location, sources
from solver.errors import MbdError, SceneError
from solver.files.scene import load_scene_text
from solver.findings import Certified, LevelReport, Limit
from solver.inputs.maneuver import Maneuver
from solver.inputs.recorded import recorded
from solver.scene import Scene

FIXED: dict[str, Any] = {'kind': 'alf', 'step_policy': 'constant', 'penalty_policy': 'constant', 'order': 2}
OK = 'ok'  # status of a plan that is certified
INCOMPLETE = 'incomplete'  # of one that had no time for all, or no other maneuvers to check on


class Certificate(NamedTuple):
    """Certificate of a plan for runs of its scene. hash: of the plan."""

    hash: str
    envelope: tuple[Limit, ...]
    certified: tuple[Certified, ...]


def key(scene: Scene) -> str:
    """Digest of everything that a plan of this scene depends on. Raises what the reader of a recording raises that its
    maneuver takes."""
    chosen: dict[str, Any] = {'h': 1e-3, 'rho_inf': 0.8, 'mode': 'fixed', 'iterations': 1, 'tolerance': 1e-8}
    integrator = dataclasses.replace(scene.integrator, **chosen, **FIXED)
    driven = (scene.start, scene.maneuver, scene.actuation, scene.assistance, scene.duration)
    parts = (scene.model, *driven, scene.require.accuracy, scene.require.limits, scene.budget, integrator)
    return digest(sources(), *map(repr, parts), *_recorded(scene.maneuver)).hex()


def _recorded(maneuver: Maneuver) -> list[bytes]:
    """The inputs in the recording that a maneuver takes, whose name stays where it is made anew; nothing of one that
    takes none."""
    if not maneuver.bag:
        return []
    found = recorded(maneuver.bag, maneuver.map, maneuver.log_times)
    rows = [(name, values.tobytes()) for name, values in sorted(found.rows.items())]
    tracks = [(name, track.t_ns.tobytes(), track.values.tobytes()) for name, track in sorted(found.tracks.items())]
    return [repr((found.h_ns, found.first, found.steps, sorted(found.start.items()), rows, tracks)).encode()]


def beside_text(scene: Scene) -> list[bytes]:
    """Data on which runs of a scene depend beside its resolved text: the inputs in the recording that its maneuver
    takes, and its plan. Raises what the reader of a recording raises."""
    plan = plan_of(scene) if scene.require.accuracy or scene.fidelity == 'auto' else None
    said = (
        {}
        if plan is None
        else {name: plan[name] for name in ('status', 'fidelity', 'settings', 'envelope', 'findings')}
    )
    return [*_recorded(scene.maneuver), json.dumps(said, sort_keys=True).encode()]


def plan_of(scene: Scene) -> dict[str, Any] | None:
    """The kept plan of a scene, None without one."""
    store, name = _store(scene)
    content = store.read(name)
    return None if content is None else json.loads(content)


def keep(scene: Scene, plan: Mapping[str, Any]) -> bool:
    """Keep the plan of a scene; False where nothing can be written, and there is none at the next start."""
    store, name = _store(scene)
    try:
        store.write(name, json.dumps(plan, allow_nan=False).encode())
    except OSError:
        return False
    return True


def _store(scene: Scene) -> tuple[Store, str]:
    return Store(location() / 'plans'), f'{key(scene)}.json'


def resolved(scene: Scene) -> tuple[Scene, Certificate]:
    """(the scene as its plan resolves it, its certificate). Raises SceneError where there is no plan."""
    plan = plan_of(scene)
    begin = f"scene {scene.name!r}: fidelity = 'auto'"
    if plan is None:
        raise SceneError(
            f'{begin}: there is no plan of this scene as it stands; make one with mbd plan, or name a level, e.g. '
            "'full'"
        )
    if plan['status'] == INCOMPLETE:
        why = '; '.join(plan['give'])
        raise SceneError(f"{begin}: its plan is incomplete: {why}; make it anew, or name a level, e.g. 'full'")
    if plan['status'] != OK:
        raise SceneError(
            f'{begin}: its plan found nothing that keeps what is required; relax require or budget, or name a level, '
            "e.g. 'full'"
        )
    return chosen(scene, plan), _certificate(plan)


def _certificate(plan: Mapping[str, Any]) -> Certificate:
    envelope = tuple(
        Limit(
            quantity=e['quantity'],
            unit=e['unit'],
            low=e['low'],
            high=e['high'],
            why='the plan is certified for this range',
        )
        for e in plan['envelope']
    )
    return Certificate(plan['hash'], envelope, tuple(Certified(**one) for one in plan['findings']))


def chosen(scene: Scene, plan: Mapping[str, Any]) -> Scene:
    """The scene with what a plan has chosen in place, in its resolved text too: a recording of it needs no plan.

    Fewer of the longer steps lie between two messages of a recording, so that it is no coarser in time than the scene
    has it.
    """
    settings = plan['settings']
    integrator = settings['integrator'] | FIXED
    every = max(1, min(scene.record.every, int(scene.record.every * scene.integrator.h / integrator['h'] + 1e-6)))
    if scene.resolved:
        switches = ', '.join(f'{name}: {state}' for name, state in settings['switches'].items())
        overrides = [
            f'fidelity={plan["fidelity"]}',
            f'switches={{{switches}}}',
            *(f'integrator.{k}={v}' for k, v in integrator.items()),
        ]
        overrides += [f'record.every={every}'] if every != scene.record.every else []
        return load_scene_text(scene.resolved, scene.name, overrides)
    integrator = dataclasses.replace(scene.integrator, **integrator)
    record = dataclasses.replace(scene.record, every=every)
    return dataclasses.replace(
        scene, fidelity=plan['fidelity'], switches=settings['switches'], integrator=integrator, record=record
    )


def certificate_of(scene: Scene) -> Certificate | None:
    """The certificate of the kept plan that certifies a scene as it is integrated, None where there is none."""
    plan = None
    if scene.require.accuracy:
        with suppress(MbdError):  # a recording that cannot be read any more
            plan = plan_of(scene)
    if plan is None or plan['status'] != OK:
        return None
    asked = scene if scene.fidelity == 'auto' else chosen(scene, plan)
    off = {name for name, state in scene.switches.items() if state == 'off'}
    same = (
        asked.fidelity == scene.fidelity
        and {*plan['settings']['switches']} == off
        and asked.integrator == scene.integrator
    )
    return _certificate(plan) if scene.fidelity == 'auto' or same else None


def with_certificate(report: LevelReport, certificate: Certificate) -> LevelReport:
    """The report on a level, with where a certificate holds and what it covers."""
    validity = (*report.validity, *certificate.envelope)
    return dataclasses.replace(report, validity=validity, certified=certificate.certified, certificate=certificate.hash)
