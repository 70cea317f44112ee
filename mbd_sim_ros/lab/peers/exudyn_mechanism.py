"""Runs planar mechanisms in Exudyn, as a program of its own: one JSON object on stdin, one on stdout. Needs exudyn
only.

Input: bodies [{m, I, x, y, phi, vx, vy, w}] (centre of mass, world), revolutes [[a, [x, y], b, [x, y]]] with points
from the centre of mass in body axes (body -1 is the ground, points in the world), sliders [body] (x free), springs [[a,
point, b, point, length, stiffness, damping]], torques [[body, N m]], gravity [m/s^2] along y, instants [s] (equidistant
from 0), observe [[body, coordinate 0..2]], runs [{h, rho, tolerance, solver, every_step: a matrix in every step}].
Output: version and, per run, values (instants, observed; change since t = 0), cpu [s], counters, or error.
"""

import json
import sys
import time


def assemble(exu, items, model):
    """(system, sensor number of every node that is observed) of a model."""
    mbs = exu.SystemContainer().AddSystem()
    ground = mbs.AddObject(items.ObjectGround())
    fixed = mbs.AddMarker(items.MarkerNodeCoordinate(nodeNumber=mbs.AddNode(items.NodePointGround()), coordinate=0))
    nodes, bodies = [], []
    for b in model['bodies']:
        node = mbs.AddNode(
            items.NodeRigidBody2D(
                referenceCoordinates=[b['x'], b['y'], b['phi']],
                initialCoordinates=[0, 0, 0],
                initialVelocities=[b['vx'], b['vy'], b['w']],
            )
        )
        body = mbs.AddObject(items.ObjectRigidBody2D(physicsMass=b['m'], physicsInertia=b['I'], nodeNumber=node))
        marker = mbs.AddMarker(items.MarkerBodyMass(bodyNumber=body))
        mbs.AddLoad(items.LoadMassProportional(markerNumber=marker, loadVector=[0, model['gravity'], 0]))
        nodes.append(node)
        bodies.append(body)

    def rigid(body, point):
        return mbs.AddMarker(
            items.MarkerBodyRigid(bodyNumber=ground if body < 0 else bodies[body], localPosition=[*point, 0])
        )

    for a, p, b, q in model['revolutes']:
        mbs.AddObject(items.ObjectJointRevolute2D(markerNumbers=[rigid(a, p), rigid(b, q)]))
    for body in model['sliders']:
        for coordinate in (1, 2):
            own = mbs.AddMarker(items.MarkerNodeCoordinate(nodeNumber=nodes[body], coordinate=coordinate))
            mbs.AddObject(items.CoordinateConstraint(markerNumbers=[fixed, own]))
    for a, p, b, q, length, stiffness, damping in model['springs']:
        mbs.AddObject(
            items.ObjectConnectorSpringDamper(
                markerNumbers=[rigid(a, p), rigid(b, q)], referenceLength=length, stiffness=stiffness, damping=damping
            )
        )
    for body, torque in model['torques']:
        mbs.AddLoad(items.LoadTorqueVector(markerNumber=rigid(body, [0, 0]), loadVector=[0, 0, torque]))
    coordinates = exu.OutputVariableType.Coordinates
    sensors = {
        body: mbs.AddSensor(
            items.SensorNode(nodeNumber=nodes[body], storeInternal=True, outputVariableType=coordinates)
        )
        for body in sorted({body for body, _ in model['observe']})
    }
    mbs.Assemble()
    return mbs, sensors


def run(exu, items, model, settings):
    """One run: its values at the instants, CPU time and counters."""
    mbs, sensors = assemble(exu, items, model)
    instants = model['instants']
    simulation = exu.SimulationSettings()
    integration = simulation.timeIntegration
    integration.endTime = instants[-1]
    integration.numberOfSteps = round(instants[-1] / settings['h'])
    integration.generalizedAlpha.spectralRadius = settings['rho']
    integration.newton.relativeTolerance = settings['tolerance']
    integration.newton.useModifiedNewton = True
    integration.newton.modifiedNewtonJacUpdatePerStep = settings['every_step']
    integration.adaptiveStep = False
    integration.verboseMode = 0
    simulation.linearSolver.solverType = exu.LinearSolverType.__members__[settings['solver']]
    simulation.parallel.numberOfThreads = 1
    simulation.solutionSettings.writeSolutionToFile = False
    simulation.solutionSettings.sensorsWritePeriod = instants[0]
    before = time.process_time()
    mbs.SolveDynamic(simulation)
    cpu = time.process_time() - before
    found = {body: mbs.GetSensorStoredData(sensor) for body, sensor in sensors.items()}
    times = next(iter(found.values()))[:, 0]
    values = []
    for t in instants:
        row = abs(times - t).argmin()
        if abs(times[row] - t) > 0.5 * settings['h']:
            raise RuntimeError(f'no output at {t:g} s')
        values.append([float(found[body][row, 1 + coordinate]) for body, coordinate in model['observe']])
    counters = mbs.sys['dynamicSolver'].it
    return {
        'values': values,
        'cpu': cpu,
        'factorizations': int(counters.newtonJacobiCount),
        'evaluations': int(counters.newtonStepsCount),
    }


def main():
    """Run what stdin asks for."""
    model = json.load(sys.stdin)
    sys.exudynFast = True  # type: ignore[attr-defined]  # its build without range checks
    import exudyn as exu
    import exudyn.itemInterface as items

    exu.SetWriteToConsole(False)
    results = []
    for settings in model['runs']:
        try:
            results.append(run(exu, items, model, settings))
        except Exception as error:  # of the solver, e.g. no convergence: a result
            results.append(
                {'error': str(error).strip().splitlines()[0][:200] if str(error).strip() else type(error).__name__}
            )
    exu.SetWriteToConsole(True)
    print('\n' + json.dumps({'version': exu.__version__, 'results': results}))


if __name__ == '__main__':
    main()
