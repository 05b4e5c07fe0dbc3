"""Monte-Carlo experiments: the figures of the paper, recomputed, with the limits beside them.

    J. Yang, C.-K. Wen, S. Jin, "Hybrid Active and Passive Sensing for SLAM in Wireless
    Communication Systems", Section V.

:mod:`~estimator.experiments.catalogue` lists the figures, each of which is a module of its own;
:mod:`~estimator.experiments.room` and :mod:`~estimator.experiments.cases` say what is simulated,
:mod:`~estimator.experiments.runs` runs and judges it, :mod:`~estimator.experiments.report` writes it down.
"""
