"""Glue of network: the final candidate pairs, with sections and pictures."""

from tiegraph.network.network import join_network, with_bases
from tiegraph.pipeline.files import load_npz, load_scene, pairs_of, save_npz, ties_of, visibility_of
from tiegraph.pipeline.preview import up_light
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome, save_json, write_atomic


def network(run: Run) -> Outcome:
    """The pairs left by candidates and the coarse model, the survey cut into sections, and the tie graph drawn."""
    scene = load_scene(run.path("coarse", "scene.json"))
    light = up_light(run, scene)
    settings = run.settings.candidates, run.settings.network
    pairs, ties = pairs_of(run, "coarse.npz"), ties_of(run)
    found = join_network(pairs, scene, ties, light, settings, run.settings.tuning.network)
    visibility = visibility_of(run)
    good = found.pairs if visibility is None else with_bases(found.pairs, found.scene, visibility)
    save_npz(run.path("network.npz"), **good.to_npz())
    write_atomic(run.path("network.csv"), good.to_csv(scene.names))
    write_atomic(run.path("network", "scene.json"), found.scene.to_json())
    sections = found.cut.sections
    cut = [{"number": k, "name": s.name, "kind": s.kind} for k, s in enumerate(sections)]
    save_json(run.path("network", "sections.json"), cut)
    model = run.path("coarse", "model.npz")
    for name, picture in found.plots(load_npz(model)["cam_from_world"] if model.exists() else None):
        write_atomic(run.path("network", f"{name}.png"), picture)
    funnel = found.pairs.funnel()
    rows = [[name, count] for name, count in funnel.items()]
    return Outcome(
        {"candidates": funnel["candidates"], "kept": funnel["used"], "sections": len(sections)},
        notes=found.notes,
        tables={"funnel": {"columns": ["step", "pairs"], "rows": rows}},
    )
