"""What is asked: state, observations, rewards, terminations, randomisation, disturbances."""
