"""How often the simulation thread looks into the topics of commands: 20 us that a step of a small model does not
have."""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace

import pytest
from client import client
from synthetic import Synthetic

from mbd_sim_ros.node.latch import Latch
from mbd_sim_ros.node.pace import Pace

pytestmark = pytest.mark.realtime

__all__ = ['client']  # a fixture


@pytest.mark.parametrize(('mode', 'looks'), [('realtime', 100), ('lockstep', 1000)])
def test_of_nobody_known_commands_are_looked_for_a_hundred_times_a_second_and_then_every_step(
    client, monkeypatch, mode, looks
):
    """A second of steps of 1 ms, then somebody publishes. Lockstep waits for answers and always looks."""
    from mbd_sim_ros.node import commands as module

    now, message, commanded = [50.0], [None], []
    monkeypatch.setattr(module.time, 'monotonic', lambda: now[0])
    monkeypatch.setattr(module, 'Node', partial(module.Node, context=client.node.context))
    latch = Latch(Synthetic(), Pace(mode=mode), ('steering', 'drive_torque', 'brake_torque'))
    commands = module.Commands(client.node, latch, deaf=False)
    commands.look_around()
    assert not commands.commanded
    taken = []

    def take(kind, raw):
        taken.append(now[0])
        return message[0]

    commands._boxes = [(take, None, lambda message: commanded.append(message.data))]
    commands._next_look = now[0]
    for k in range(1000):
        now[0] = 50.0 + k * 1e-3 + 1e-9
        commands.poll()
    assert len(taken) == pytest.approx(looks, abs=1)
    message[0] = (SimpleNamespace(data=0.25), None)
    for _ in range(10):
        now[0] += 1e-3
        commands.poll()
        message[0] = message[0] if not commanded else None
    assert commanded == [0.25]
    assert commands.commanded
    count = len(taken)
    for _ in range(10):
        now[0] += 1e-3
        commands.poll()
    assert len(taken) == count + 10
    commands.close()
