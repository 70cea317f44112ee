"""Runs spatial models in Exudyn, as a program of its own: one JSON object on stdin, one on stdout. Needs exudyn only.

Input (solver conventions, SI; a frame is [body, point from its centre of mass, axes as columns], body -1 is the
ground): gravity, bodies [{mass, inertia, p, R, v, w}] (world), joints [[constrained axes, frame, frame]], bushings
[[frame, frame, stiffness x6, damping x6]], springs [[frame, frame, free length, stiffness, damping]], torsions [[frame,
frame, stiffness, damping]] about z, every [s] of the output, runs [{h, duration, rho, tolerance, rotations: euler or
lie, solver, modified: Newton, every_step: a matrix in every step}]. Output: version and, per run, positions (instants,
bodies, 3), cpu [s] of the steps and counters per step, or error.
"""

import json
import sys
import time

import numpy as np


def assemble(exu, items, model, rotations):
    """(system, sensors) of a model; rotations: how nodes describe them."""
    from exudyn.utilities import RigidBodyInertia

    mbs = exu.SystemContainer().AddSystem()
    ground = mbs.AddObject(items.ObjectGround())
    kinds = {'euler': exu.NodeType.RotationEulerParameters, 'lie': exu.NodeType.RotationRotationVector}
    bodies = [
        mbs.CreateRigidBody(
            inertia=RigidBodyInertia(mass=b['mass'], inertiaTensor=np.array(b['inertia'])),
            nodeType=kinds[rotations],
            referencePosition=b['p'],
            referenceRotationMatrix=np.array(b['R']),
            initialVelocity=b['v'],
            initialAngularVelocity=b['w'],
            gravity=model['gravity'],
        )
        for b in model['bodies']
    ]

    def rigid(frame):
        return mbs.AddMarker(
            items.MarkerBodyRigid(bodyNumber=ground if frame[0] < 0 else bodies[frame[0]], localPosition=frame[1])
        )

    def pair(a, b):
        return {'markerNumbers': [rigid(a), rigid(b)]}

    def axes(a, b):
        return {'rotationMarker0': np.array(a[2]), 'rotationMarker1': np.array(b[2])}

    for constrained, a, b in model['joints']:
        if constrained[3:] == [0, 0, 0] and constrained[2]:
            mbs.AddObject(items.ObjectJointSpherical(**pair(a, b)))
        elif constrained == [1, 1, 1, 1, 1, 0]:
            mbs.AddObject(items.ObjectJointRevoluteZ(**pair(a, b), **axes(a, b)))
        else:
            mbs.AddObject(items.ObjectJointGeneric(constrainedAxes=constrained, **pair(a, b), **axes(a, b)))
    for a, b, stiffness, damping in model['bushings']:
        if a[0] < 0 and not any(stiffness[3:]) and not any(damping[3:]):
            mbs.AddObject(
                items.ObjectConnectorCartesianSpringDamper(**pair(a, b), stiffness=stiffness[:3], damping=damping[:3])
            )
        else:
            mbs.AddObject(
                items.ObjectConnectorRigidBodySpringDamper(
                    **pair(a, b), **axes(a, b), stiffness=np.diag(stiffness), damping=np.diag(damping)
                )
            )
    for a, b, length, stiffness, damping in model['springs']:
        mbs.AddObject(
            items.ObjectConnectorSpringDamper(
                **pair(a, b), referenceLength=length, stiffness=stiffness, damping=damping
            )
        )
    for a, b, stiffness, damping in model['torsions']:
        mbs.AddObject(
            items.ObjectConnectorTorsionalSpringDamper(**pair(a, b), **axes(a, b), stiffness=stiffness, damping=damping)
        )
    sensors = [
        mbs.AddSensor(
            items.SensorBody(bodyNumber=body, storeInternal=True, outputVariableType=exu.OutputVariableType.Position)
        )
        for body in bodies
    ]
    mbs.Assemble()
    return mbs, sensors


def run(exu, items, model, settings):
    """One run: positions at the instants, CPU time of the steps, counters."""
    mbs, sensors = assemble(exu, items, model, settings['rotations'])
    simulation = exu.SimulationSettings()
    integration = simulation.timeIntegration
    integration.endTime = settings['duration']
    integration.numberOfSteps = round(settings['duration'] / settings['h'])
    integration.generalizedAlpha.spectralRadius = settings['rho']
    integration.newton.relativeTolerance = settings['tolerance']
    integration.newton.useModifiedNewton = settings['modified']
    integration.newton.modifiedNewtonJacUpdatePerStep = settings['every_step']
    integration.adaptiveStep = False
    integration.verboseMode = 0
    simulation.linearSolver.solverType = exu.LinearSolverType.__members__[settings['solver']]
    simulation.parallel.numberOfThreads = 1
    simulation.solutionSettings.writeSolutionToFile = False
    simulation.solutionSettings.sensorsWritePeriod = model['every']
    before = time.process_time()
    mbs.SolveDynamic(simulation)
    cpu = time.process_time() - before
    values = np.stack([mbs.GetSensorStoredData(sensor)[:, 1:4] for sensor in sensors], axis=1)
    counters = mbs.sys['dynamicSolver'].it
    steps = integration.numberOfSteps
    return {
        'positions': values.tolist(),
        'cpu': cpu,
        'factorizations': counters.newtonJacobiCount / steps,
        'iterations': counters.newtonStepsCount / steps,
    }


def main():
    """Read, run everything, write."""
    sys.exudynFast = True  # type: ignore[attr-defined]  # its build without range checks
    import exudyn as exu
    import exudyn.itemInterface as items

    exu.SetWriteToConsole(False)
    model = json.load(sys.stdin)
    results = []
    for settings in model['runs']:
        try:
            results.append(run(exu, items, model, settings))
        except Exception as error:  # of the solver, e.g. no convergence: a result
            results.append({'error': ' '.join(str(error).split())[:200] or type(error).__name__})
    exu.SetWriteToConsole(True)
    print('\n' + json.dumps({'version': exu.__version__, 'results': results}))


if __name__ == '__main__':
    main()
