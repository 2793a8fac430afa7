"""What all fits share: equations with named sources of uncertainty, least squares of a triad, curves over temperature.

    equations       rows of three sensors, blocks of unknowns (K, b, H), sources; gains, covariance, budget, the inverse model;
                    families of covariances by restricted likelihood; rows that are not linear, priors as rows among them
    least_squares   s = K a + b of a triad, its verdict; excess variance; Huber's weights; noise of means
    smooth          curves over temperature, with their covariance

In: readings, what multiplies their unknowns, and what is known of their errors. Out: unknowns with covariance and, by source, their
budget: certificate, report and verdict read these alone. Arrays have the rows first: readings (E, 3), designs (E, P); covariances
of rows are (3, E, E), one of each sensor. Units are those of the readings; nothing here knows a session. Open equations first.
"""
