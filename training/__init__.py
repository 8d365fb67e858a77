"""Everything that makes the models: simulator, data sets, networks, training, evaluation, export."""
