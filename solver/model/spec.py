"""ModelSpec: everything a model consists of, as data."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from solver.dimensions import Acceleration, WheelTurn
from solver.elements.coordinate import CoordinateSpec
from solver.elements.marker import Spec
from solver.elements.registry import CONSTRAINTS, KINDS
from solver.elements.rigid_body import RigidBodySpec
from solver.elements.road import RoadSpec
from solver.errors import SpecError, suggestion
from solver.inputs.maneuver import ACCELERATION, RATE
from solver.units import MODEL_GRAVITY
from solver.validate import finite, vector

FLAT = RoadSpec()
T = TypeVar('T')


def _with_kinds(cls: type[T]) -> type[T]:
    """A frozen dataclass with a further field, a tuple of specifications, for every registered kind of element."""
    kinds: dict[str, Any] = {kind.name: tuple[kind.spec, ...] for kind in KINDS}  # type: ignore[name-defined]
    for name in kinds:
        setattr(cls, name, ())
    own = dict(cls.__annotations__)
    first = {name: own.pop(name) for name in ('bodies', 'coordinates')}
    cls.__annotations__ = first | kinds | own
    return dataclass(frozen=True, kw_only=True)(cls)


@_with_kinds
class ModelSpec:
    """A mechanism or vehicle on a road. Names are unique within their kind; order is kept everywhere.

    Joints of kind revolute, prismatic and cylindrical define joint coordinates named after them; `coordinates` adds
    others. Every kind of element in solver.elements.registry has a field of its name. chassis: the body that odom and
    imu describe (None: the first body). category: kind of vehicle, whose typical values its figures are compared with
    (solver.analysis.typical_values). lock: angle of the steering wheel at its end stops, to either side [rad]; None: no
    end stops. added: (section, name) of each element that the scene adds to a vehicle's template
    (solver.files.vehicle).
    """

    bodies: tuple[RigidBodySpec, ...]
    coordinates: tuple[CoordinateSpec, ...] = ()
    road: RoadSpec = FLAT
    gravity: tuple[Acceleration, Acceleration, Acceleration] = (0.0, 0.0, -MODEL_GRAVITY)
    inputs: tuple[str, ...] = ()
    chassis: str | None = None
    category: str = ''
    lock: WheelTurn | None = None
    added: tuple[tuple[str, str], ...] = field(default=(), metadata={'key': False})

    if TYPE_CHECKING:  # what a type checker cannot know of the fields that the registry adds
        __dataclass_fields__: ClassVar[dict[str, Any]]

        def __init__(self, **fields: Any) -> None: ...
        def __getattr__(self, name: str) -> Any: ...

    def __post_init__(self) -> None:
        object.__setattr__(self, 'gravity', vector('model', 'gravity', self.gravity))
        if self.lock is not None:
            finite('model', 'lock', self.lock, low=0.0, strict=True)
        if not self.bodies:
            raise SpecError('model: bodies is empty: a model needs at least one body')
        names = [body.name for body in self.bodies]
        if self.chassis is not None and self.chassis not in names:
            raise SpecError(f'model: chassis = {self.chassis!r}: no such body' + suggestion(self.chassis, names))
        for section, specs in self.sections().items():
            seen: set[str] = set()
            for spec in specs:
                if spec.name in seen:
                    raise SpecError(
                        f'{spec.where}: name = {spec.name!r}: is used twice among the {section}; rename one'
                    )
                seen.add(spec.name)

    def sections(self) -> dict[str, tuple[Spec, ...]]:
        """The specifications of bodies, coordinates and elements by the names of their fields."""
        return {name: getattr(self, name) for name in SECTIONS}


INPUTS = ('input', 'own_input', 'gear')  # fields of specifications that name an input channel
SECTIONS = ('bodies', 'coordinates', *(kind.name for kind in KINDS))


def used_inputs(model: ModelSpec) -> tuple[str, ...]:
    """Input channels that the elements of a model mention, in order of first mention; drivers with their
    derivatives."""
    names: dict[str, None] = {}
    motions = {kind.name for kind in CONSTRAINTS}
    for section, specs in model.sections().items():
        for spec in specs:
            for key in INPUTS:
                name = getattr(spec, key, None)
                if isinstance(name, str):
                    names[name] = None
                    if section in motions:
                        names[name + RATE] = names[name + ACCELERATION] = None
    return tuple(names)
