"""What all fits share: equations with named sources of uncertainty, least squares of a triad, curves over temperature.

    equations       rows of three sensors, blocks of unknowns (K, b, H), sources; gains, covariance, budget, the inverse model;
                    families of covariances by restricted likelihood; rows that are not linear
    least_squares   s = K a + b of a triad, its verdict; excess variance; noise of means
    smooth          curves over temperature, with their covariance

Arrays have the rows first: readings (E, 3), designs (E, P); covariances of rows are (3, E, E), one of each sensor. Units are those
of the readings; nothing here knows a session. Open equations first.
"""
