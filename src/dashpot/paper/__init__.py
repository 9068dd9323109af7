"""The paper's experiments on a simulated arm: Figs. 4, 5 and 6 and the relations that they show."""
