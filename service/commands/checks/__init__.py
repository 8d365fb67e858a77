"""What `physnet doctor` looks at: the machine, the packages, the settings and models, a prediction."""
