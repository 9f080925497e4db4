"""What several tests and benchmarks share: arms, servos, objects and recordings drawn at random; live nodes; pages."""
