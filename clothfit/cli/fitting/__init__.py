"""The parts of `clothfit estimate`.

target_options and plan (what is fitted to what) → checkpoints, recording and fit_log (what is kept on the way) →
parameter_line, outcomes and table (what is said of the result) → estimate_report; many is for several scenes.
"""
