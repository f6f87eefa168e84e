"""What is asked: state, observations, rewards, terminations, randomisation and disturbances as pure functions."""
