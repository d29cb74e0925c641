"""The support function of R_k(F) as a mixed-integer program, solved by HiGHS."""
