"""Runs planar linkages in MuJoCo, as a program of its own: one JSON object on stdin, one on stdout. Needs mujoco only.

Input: bodies [{m, I, x, y, phi, vx, vy, w}] (centre of mass, world), revolutes [[a, [x, y], b, [x, y]]] with points
from the centre of mass in body axes (body -1 is the ground, points in the world), gravity [m/s^2] along y, instants [s]
(equidistant from 0), runs [{h, integrator, solref, solimp}]. Bodies hang on each other by the first revolute that
reaches them; the others close loops (`connect`). Output: version and, per run, values (instants, bodies, x y phi), cpu
[s] of the steps, or error.
"""

import json
import math
import sys
import time


def tree(model):
    """([(body, parent, revolute)] parents first, revolutes that close loops)."""
    placed, left, branches, loops = {-1}, list(model['revolutes']), [], []
    while left:
        for revolute in left:
            a, p, b, q = revolute
            if a in placed and b in placed:
                loops.append(revolute)
            elif a in placed:
                branches.append((b, a, [a, p, b, q]))
                placed.add(b)
            elif b in placed:
                branches.append((a, b, [b, q, a, p]))
                placed.add(a)
            else:
                continue
            left.remove(revolute)
            break
        else:
            raise ValueError('some bodies hang on nothing')
    return branches, loops


def compiled(mujoco, model, settings):
    """(model, velocities of the joints by name) for the settings of a run."""
    branches, loops = tree(model)
    spec = mujoco.MjSpec()
    spec.option.timestep = settings['h']
    spec.option.gravity = [0.0, model['gravity'], 0.0]
    spec.option.integrator = getattr(mujoco.mjtIntegrator, f'mjINT_{settings["integrator"]}')
    spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_ISLAND
    ground = {'x': 0.0, 'y': 0.0, 'phi': 0.0, 'w': 0.0}
    bodies, rates = {-1: spec.worldbody}, {}
    for body, parent, (_, _, _, point) in branches:
        above, own = ground if parent < 0 else model['bodies'][parent], model['bodies'][body]
        dx, dy, turned = own['x'] - above['x'], own['y'] - above['y'], own['phi'] - above['phi']
        cos, sin = math.cos(above['phi']), math.sin(above['phi'])
        bodies[body] = bodies[parent].add_body(
            name=f'b{body}',
            pos=[cos * dx + sin * dy, cos * dy - sin * dx, 0.0],
            quat=[math.cos(turned / 2), 0.0, 0.0, math.sin(turned / 2)],
            mass=own['m'],
            inertia=[own['I']] * 3,
            ipos=[0.0, 0.0, 0.0],  # the defaults are those of the body in its parent
            iquat=[1.0, 0.0, 0.0, 0.0],
            explicitinertial=True,
        )
        bodies[body].add_joint(name=f'j{body}', type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1], pos=[*point, 0.0])
        rates[f'j{body}'] = own['w'] - above['w']
    for a, p, b, q in loops:
        first, second, point = (b, a, q) if a < 0 else (a, b, p)
        equality = spec.add_equality(
            type=mujoco.mjtEq.mjEQ_CONNECT,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            name1=f'b{first}',
            name2='world' if second < 0 else f'b{second}',
            solref=settings['solref'],
            solimp=settings['solimp'],
        )
        equality.data[:3] = [*point, 0.0]
    return spec.compile(), rates


def run(mujoco, model, settings):
    """One run: places of all bodies at the instants, CPU time of the steps."""
    compiled_model, rates = compiled(mujoco, model, settings)
    data = mujoco.MjData(compiled_model)
    for name, rate in rates.items():
        data.qvel[compiled_model.joint(name).dofadr[0]] = rate
    mujoco.mj_forward(compiled_model, data)
    numbers = [compiled_model.body(f'b{k}').id for k in range(len(model['bodies']))]
    each = round(model['instants'][0] / settings['h'])
    values, cpu = [], 0.0
    for _ in model['instants']:
        before = time.process_time()
        mujoco.mj_step(compiled_model, data, each)
        cpu += time.process_time() - before
        if any(warning.number for warning in data.warning):
            raise RuntimeError(f'unstable before {data.time:g} s')
        mujoco.mj_kinematics(compiled_model, data)  # of the positions that the last step ended with
        values.append([[*data.xipos[k, :2].tolist(), math.atan2(data.ximat[k, 3], data.ximat[k, 0])] for k in numbers])
    return {'values': values, 'cpu': cpu}


def main():
    """Run what stdin asks for."""
    model = json.load(sys.stdin)
    import mujoco

    mujoco.set_mju_user_warning(lambda text: None)  # an unstable run is a result, not a line in a log file
    results = []
    for settings in model['runs']:
        try:
            results.append(run(mujoco, model, settings))
        except Exception as error:
            results.append({'error': ' '.join(str(error).split())[:200] or type(error).__name__})
    print('\n' + json.dumps({'version': mujoco.__version__, 'results': results}))


if __name__ == '__main__':
    main()
