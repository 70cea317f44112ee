"""The health of a running simulation as a diagnostic status: figures, and what is wrong in one sentence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from mbd_sim_ros.bags.recorder import Recorder
from mbd_sim_ros.node.commands import commanded
from mbd_sim_ros.node.loop import Loop
from solver.analysis.certificate_coverage import Weighed, weighed
from solver.analysis.envelope import Envelope
from solver.analysis.kept_errors import NONE
from solver.analysis.verdict import status_of
from solver.checks.level import ENVELOPE
from solver.errors import BagError
from solver.findings import Finding
from solver.simulation import Simulation

SLOW = 0.98  # of the wanted rate, below which real time is not kept


def judged(simulation: object, envelope: Envelope | None = None, *, ended: bool = False) -> list[Finding]:
    """Findings on the run so far; none for a stand-in, which keeps no account. envelope: of the plan that was taken, if
    any.

    ended: see Envelope.findings.
    """
    return _weighed(simulation, envelope, ended=ended).suspect


def _weighed(simulation: object, envelope: Envelope | None, *, ended: bool = False) -> Weighed:
    if isinstance(simulation, Simulation):
        return weighed(simulation, envelope, ended=ended)
    return Weighed([] if envelope is None else envelope.findings(ended=ended), [])


def diagnosis(
    loop: Loop,
    recorder: Recorder | None,
    failed_recording: BagError | None,
    *,
    refused: int = 0,
    namesakes: int = 0,
    envelope: Envelope | None = None,
    unpublished: Mapping[str, int] | None = None,
    unmatched: Sequence[str] = (),
    error: str = NONE,
) -> DiagnosticStatus:
    """Level, message and values since the last call; name and hardware_id are left to the caller.

    refused: commands that were no numbers or named no input. namesakes: other nodes of the same name. envelope: see
    judged. unpublished: messages that the budget of publishing dropped, by topic. unmatched: what the graph does not
    match (see node.graph). error: the numerical error of this scene, as it was measured at another time
    (solver.analysis.kept_errors).
    """
    health = loop.health()
    values = {
        'simulation time [s]': f'{loop.simulation.t_ns * 1e-9:.3f}',
        'mode': loop.pace.mode + (' (paused)' if loop.paused else ''),
        'real-time factor': f'{health.rate:.4f}',
        'steps': health.steps,
        'overruns': health.overruns,
        'schedule slips': health.slips,
        'step time p50 [ms]': f'{health.step_p50 * 1e3:.3f}',
        'step time p99 [ms]': f'{health.step_p99 * 1e3:.3f}',
        'step time max [ms]': f'{health.step_max * 1e3:.3f}',
        'iterations': health.iterations,
        'residual': f'{health.residual:.3g}',
        'command age [s]': f'{health.command_age:.3f}',
        'lockstep answers taken': loop.latch.answers.taken,
        'lockstep answers refused': loop.latch.answers.refused,
        'lockstep surplus commands': loop.latch.answers.surplus,
        'commands refused': refused,
        'not matched in the graph': len(unmatched),
        'recorder lag [steps]': recorder.lag if recorder else 0,
        'recorder dropped [steps]': recorder.dropped if recorder else 0,
    }
    problems = []
    if loop.latch.stale:
        driven = dict.fromkeys(commanded(name).called for name in loop.latch.stale)
        problems.append(f'{" and ".join(driven)} command is too old and counts as zero')
    if namesakes:
        problems.append('another node has the same name: both take the commands and publish the same topics')
    problems += unmatched
    if recorder and recorder.dropped:
        problems.append('recording has lost steps')
    if (
        loop.pace.mode == 'realtime'
        and not loop.paused
        and health.rate < SLOW * loop.pace.rate_factor
        and health.steps > 0
    ):
        problems.append('slower than real time')
    if unpublished:
        values['publishing dropped'] = ', '.join(f'{topic} {count}' for topic, count in unpublished.items())
        problems.append(f'publishing takes longer than publish_budget: dropped {values["publishing dropped"]}')
    suspect, covered, _ = _weighed(loop.simulation, envelope)
    values['findings'] = len(suspect)
    values['verdict'] = status_of(suspect)
    values['numerical error'] = error
    if covered:
        values['covered by the certificate'] = '; '.join(map(str, covered))
    if envelope is not None:
        left = any(finding.quantity == ENVELOPE.name for finding in suspect)
        values['envelope'] = ('left' if left else 'kept') if envelope.watches else 'none'
    problems += [f'suspect: {finding}' for finding in suspect]
    level, text = DiagnosticStatus.OK, 'running' if not loop.paused else 'paused'
    if problems:
        level, text = DiagnosticStatus.WARN, '; '.join(problems)
    if loop.error is not None or failed_recording is not None:
        level, text = DiagnosticStatus.ERROR, str(loop.error or failed_recording)
    status = DiagnosticStatus(level=level, message=text)
    status.values = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    return status
