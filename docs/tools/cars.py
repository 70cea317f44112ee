"""Makes docs/cars.md and its pictures: `python docs/tools/cars.py OUT`, OUT the directory of `mbd study kandc --out
OUT`.

Figures from the models (solver.analysis.figures), curves from the study, and a picture of each car in a step steer,
made by mbd view.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

import contents

from mbd_sim_ros.commands.main import main
from mbd_sim_ros.lab.studies.kandc import CARS
from solver.analysis.figures import figures, standing
from solver.analysis.typical_values import Typical, typical_values
from solver.files.scene import load_scene

DOCS = Path(__file__).parents[1]
TEXTS = {
    'full_car': "The chapter's car: a rear-driven saloon, double wishbones with split lower links in front, a "
    'multi-link axle behind.',
    'light_car': 'A simple front-driven car with ideal joints: MacPherson struts in front, semi-trailing arms behind.',
    'compact_fwd': 'A front-driven compact: MacPherson struts in front, a twist beam behind, a transverse engine.',
    'pickup_awd': 'A body-on-frame pickup: double wishbones in front, a live axle on leaf springs behind, all-wheel '
    'drive.',
    'electric_4wd': 'An electric saloon with a motor per wheel on the axles of the full car.',
    'formula_student': 'A formula student car: double wishbones on rod ends, coil-overs on the lower arms, slicks, '
    'wings.',
}
HEAD = """# The delivered cars

Made by `mbd study kandc --out OUT` and `python docs/tools/cars.py OUT`. None of them is a particular car: hardpoints were laid out for the
figures below, and every other number in their files ([config/vehicles](../config/vehicles/)) is of public order of magnitude, with its
reason beside it. How cars are put together: [vehicle.md](vehicle.md). `mbd info NAME` computes the figures of any car.
"""  # noqa: E501


def page(out: Path) -> str:
    """The page; its pictures are written beside it."""
    parts = [HEAD]
    for name in CARS:
        scene = load_scene('car_step_steer', [f'vehicle=vehicles/{name}.yaml'])
        simulation = standing(scene)
        counts = simulation.describe()
        found, ranges = figures(simulation), typical_values(scene.model)
        rows = [
            '| {} | {:.4g} {} | {:.4g} to {:.4g} |'.format(
                where.text, found[key] * where.factor, where.unit, *limits(where)
            )
            for key, where in ranges.items()
            if key in found
        ]
        shutil.copy(out / f'{name}_travel.png', DOCS / 'pictures' / f'cars_{name}_curves.png')
        picture(name, DOCS / 'pictures' / f'cars_{name}.png')
        parts.append(
            f'\n## {name}\n\n{TEXTS[name]} {counts["bodies"]} bodies, {counts["joints"]} joints, {counts["bushings"]} '
            f'bushings, {counts["dof"]} degrees of freedom.\n\n![{name} in a step steer](pictures/cars_{name}.png)\n\n'
            f'![Kinematics and compliance of {name}](pictures/cars_{name}_curves.png)\n\n| figure | value | usual of '
            f'a {scene.model.category or "saloon"} |\n|---|---|---|\n' + '\n'.join(rows) + '\n'
        )
    return ''.join(parts)


def limits(where: Typical) -> tuple[float, float]:
    """In the unit of the text."""
    return where.low * where.factor, where.high * where.factor


def picture(name: str, file: Path) -> None:
    """The car in the bend of a step steer."""
    with tempfile.TemporaryDirectory() as directory:
        bag = str(Path(directory) / 'bag')
        changes = ('--set', f'vehicle=vehicles/{name}.yaml', '--set', 'duration=3', '--set', 'start.speed_kmh=60')
        for command in (
            ['run', 'car_step_steer', *changes, '--out', bag],
            ['view', bag, '--out', str(file), '--at', '2.5', '--width', '640'],
        ):
            if main(command) != 0:
                raise SystemExit(f'{name}: {" ".join(command)} failed')


if __name__ == '__main__':
    (DOCS / 'cars.md').write_text(contents.render(page(Path(sys.argv[1]))), encoding='utf-8')
