"""Port passivity of a sampled joint: whether any passive mechanism may hang on it."""
