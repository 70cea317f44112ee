"""Speed against accuracy: what of a scene may be left out, measured.

A `Setting` is a way to simulate a scene: level of detail, subsystems off, step, iterations, damping. `runs` gives the
curves of the quantities of interest, `reference` their converged limit with its band, `errors` how much of an error is
that of the model, of the step and of the iteration, `cost` what a setting costs, `bench` all of these of one scene,
each made once, `variations` maneuvers beside the one that is given, `judging` whether a setting keeps the limits, and
`search` chooses (`mbd plan`).
"""
