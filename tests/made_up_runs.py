"""Make up the files of runs, with known answers for a report."""

import json


def make(root, name, returns=500.0, *, overrides=(), evaluation=True, change=None, success=1.0):
    """Make a run as gctd3.train leaves it, without its policy."""
    run = root / name
    config = {
        "seed": int(name[-1]),
        "threads": int(name[-1]),
        "robot": {"name": "biped", "feet": None, "forward": None, "graph": "tree"},
        "task": {"_target_": "gctd3.WalkSettings", "control_dt": 0.02, "terminations": {"fall": {"height": -0.1}}},
        "evaluation": {"reward": {"terms": {"fall": {"weight": -10.0}}}, "episodes": 10},
        "algo": {"tau": 0.005},
    }
    for key, value in (change or {}).items():
        *path, last = key.split(".")
        node = config
        for part in path:
            node = node[part]
        node[last] = value
    (run / ".hydra").mkdir(parents=True)
    (run / ".hydra" / "config.yaml").write_text(json.dumps(config))
    (run / ".hydra" / "overrides.yaml").write_text(json.dumps(list(overrides)))
    lines = ["frames,wall_s,return_mean,success_rate,train_episodes", f"1000,60,5.0,0.0,7\n2000,120,{returns},1.0,9\n"]
    (run / "progress.csv").write_text("\n".join(lines))
    if evaluation:
        evaluated = {"return_mean": returns, "velocity_mean": 1.2, "success_rate": success, "body_position_mean": 0.01}
        evaluated["gait"] = {"episodes": 50, "flight_fraction": 0.25, "floquet_max": None, "asymmetry_hip_right": 0.02}
        (run / "evaluation.json").write_text(json.dumps(evaluated))
    return run


def examined(run, success, impulses, phases=(4.0, 2.0)):
    """Write the results that ``robustness=true`` leaves."""
    found = {
        "perturbations": {"impulses": impulses, "starts": 3, "recover": 3.0},
        "mass_kg": 10.0,
        "conditions": {"as trained": {"success_rate": 1.0}, "mass +20 %": {"success_rate": success}},
        "pushes": {"largest": {"forward": list(phases), "backward": [None, 4.0]}},
    }
    (run / "robustness.json").write_text(json.dumps(found))
