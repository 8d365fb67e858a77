from service.inference.registry import Models


def test_each_network_is_run_by_what_knows_its_kind(models: Models) -> None:
    assert [manifest.kind for manifest in models.manifests] == ["reconstruction", "deformation"]
    assert [graph.manifest for graph in models.graphs] == list(models.manifests)
