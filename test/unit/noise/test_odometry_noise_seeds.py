from bullet_lab.noise.odometry_noise import derived_seed


def test_derived_seeds_are_the_same_each_time_and_differ_from_each_other():
    seeds = [derived_seed(seed, index) for seed in range(20) for index in range(50)]
    assert len(set(seeds)) == len(seeds)
    assert seeds == [derived_seed(seed, index) for seed in range(20) for index in range(50)]
    # As far as a parameter of type int goes.
    assert min(seeds) >= 0
    assert max(seeds) < 2**31
