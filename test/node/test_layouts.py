"""Layouts of RViz, Foxglove and PlotJuggler show what is there: topics, fields and inputs of a car."""

from __future__ import annotations

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from synthetic import channels, snapshot

from mbd_sim_ros.messages.cdr import decode
from mbd_sim_ros.messages.definitions import schema_text
from mbd_sim_ros.messages.encode import Messages

LAYOUTS = Path(__file__).resolve().parents[2] / 'config' / 'layouts'
FURTHER = {'robot_description', 'initialpose', 'diagnostics'}


@pytest.fixture(scope='module')
def published() -> dict[str, dict]:
    """Topic -> a message of a car."""
    names = channels()
    messages = Messages(names)
    encoded = messages.encode(snapshot(names), whole=True)
    return {
        t.name.strip('/'): decode(t.type, schema_text(t.type), data)[0]
        for t, data in zip(messages.topics, encoded, strict=True)
        if data
    }


def field(message: object, path: list[str]) -> object:
    for name in path:
        assert isinstance(message, dict)
        message = message[name]
    return message


def test_rviz_shows_topics_that_there_are(published):
    layout = yaml.safe_load((LAYOUTS / 'car.rviz').read_text())['Visualization Manager']
    topics = re.findall(r"'(?:Description )?Topic': {'Value': '([^']+)'", str(layout))
    assert len(topics) == 7 and set(topics) <= published.keys() | FURTHER
    assert layout['Global Options']['Fixed Frame'] == published['odom']['header']['frame_id']
    assert layout['Views']['Current']['Target Frame'] == published['odom']['child_frame_id']


def test_foxglove_plots_fields_that_there_are(published):
    layout = json.loads((LAYOUTS / 'car.foxglove.json').read_text())
    panels = layout['configById']
    assert set(re.findall(r'\w+!\w+', json.dumps(layout['layout']))) == panels.keys()
    paths = [path['value'] for panel in panels.values() for path in panel.get('paths', ())]
    assert len(paths) >= 12
    for path in paths:
        topic, *rest = path.removeprefix('/').replace('[0]', '').split('.')
        assert np.all(np.isfinite(field(published[topic], rest))), path
    assert published['cmd_applied']['name'][0] == 'steering'
    assert {topic.strip('/') for topic in panels['3D!car']['topics']} <= published.keys()


def test_plotjuggler_plots_curves_that_there_are(published):
    root = ElementTree.parse(LAYOUTS / 'car.plotjuggler.xml').getroot()
    topics = {topic.get('name', '').strip('/') for topic in root.iter('topic')}
    assert topics <= published.keys()
    curves = [curve.get('name', '').strip('/') for curve in root.iter('curve')]
    assert len(curves) >= 12
    for curve in curves:
        topic = next(topic for topic in topics if curve.startswith(f'{topic}/'))
        rest = curve.removeprefix(f'{topic}/').split('/')
        if 'name' in published[topic]:  # named scalars: joint and part
            assert rest[0] in published[topic]['name'] and rest[1] in published[topic]
        else:
            assert np.all(np.isfinite(field(published[topic], rest))), curve
