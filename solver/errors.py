"""The exception family. Everything a user can cause ends in one of these: one sentence with place, value and remedy."""

from __future__ import annotations

import difflib
import errno
from collections.abc import Iterable


class MbdError(Exception):
    """Base of all errors that are reported to the user as one sentence."""

    exit_code = 1


class SpecError(MbdError):
    """A model specification is not acceptable: names element, field, value and limit."""

    exit_code = 2


class SceneError(MbdError):
    """A scene, vehicle, tire or maneuver file is not acceptable: names file, line, path and remedy."""

    exit_code = 2


class ConsistencyError(MbdError):
    """No consistent start (assembly, velocity or static equilibrium) was found."""

    exit_code = 3


class StepError(MbdError):
    """A step failed: names time, step, the worst constraint or body, and what to try."""

    exit_code = 4


class BagError(MbdError):
    """A recording cannot be written or read."""

    exit_code = 5


OWN = ('solver', 'mbd_sim_ros')  # packages of this program
PACKAGES = {'yaml': 'pyyaml'}  # name of a module -> that of its package, where it is another one
# of ratios of difflib: names as close as each other; ten times as much takes all that are suggested for alike
ALIKE = 0.05


def missing(error: ImportError) -> str:
    """Sentence about a module that is not installed or does not load, with what to do; '' where it is one of ours: that
    is a defect."""
    name = (error.name or '').partition('.')[0]
    if name in OWN:
        return ''
    if not isinstance(error, ModuleNotFoundError):
        text = ' '.join(str(error).split()).rstrip('.')
        return (
            f'a Python package does not load ({text}): python -m pip install --upgrade mbd_sim_ros brings versions '
            'that go together'
        )
    if name == 'rclpy' or name.endswith(('_msgs', '_srvs', '_interfaces')):
        return (
            f'{name} is missing: source a ROS 2 Jazzy installation that has it (source /opt/ros/jazzy/setup.bash), or, '
            'where there is '
            "none, install the wheels with: pip install 'mbd_sim_ros[ros]'"
        )
    package = PACKAGES.get(name, name)
    return (
        f'the Python module {name} is missing: python -m pip install {package}, or, where ROS is installed, '
        'rosdep install --from-paths SOURCES --ignore-src, which installs all that package.xml names'
    )


def refused(error: OSError) -> str:
    """Sentence on an error of the operating system. It names no file when the current directory has been removed: the
    system says then that nothing is there, and not what."""
    place = 'the current directory' if error.errno == errno.ENOENT else 'the system'
    return f'{error.filename or place}: {error.strerror or error}'


def suggestion(name: str, known: Iterable[str], unlisted: Iterable[str] = ()) -> str:
    """Return '; did you mean X?' or the list of what is allowed, to be appended to an error sentence.

    unlisted: what is allowed too, and is suggested, but not listed.
    """
    known = sorted(known)
    close = {
        one: difflib.SequenceMatcher(None, one, name) for one in difflib.get_close_matches(name, [*known, *unlisted])
    }
    if close:
        # the one of which most is one piece of the name: for energy energies, and not every
        best = max(matcher.ratio() for matcher in close.values())
        alike = {one: matcher for one, matcher in close.items() if matcher.ratio() > best - ALIKE}
        pieces = {one: matcher.find_longest_match().size / len(one) for one, matcher in alike.items()}
        return f'; did you mean {max(pieces, key=pieces.__getitem__)!r}?'
    if not known:
        return '; none are defined'
    return '; allowed: ' + ', '.join(known[:24]) + (', ...' if len(known) > 24 else '')
