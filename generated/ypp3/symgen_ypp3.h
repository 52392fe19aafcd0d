/* Inertia matrix J(q) of the robot ypp3.
 * Written by symgen 0.1.0 with CasADi 3.8.2 from the URDF with SHA-256
 * 77a56c1ef1844153c423ab75a5e50ef58ac6b83d021e72517f7fbbdac28ce5c1
 * Written by a program: change the URDF, not this file. */

#ifndef SYMGEN_YPP3_H
#define SYMGEN_YPP3_H

#ifdef __cplusplus
extern "C" {
#endif

/* Joints, base to tip:
 *   q[0]  joint1, revolute, rad
 *   q[1]  joint2, revolute, rad
 *   q[2]  joint3, revolute, rad
 */
#define YPP3_N 3 /* joints */
#define YPP3_D 6 /* constants alpha of all of J */
#define YPP3_D_DIAG 6 /* the first of them: all that the diagonal of J depends on */

/* Place of each constant in alpha, and its unit. Formulas: alpha_cad.json. */
enum ypp3_alpha {
  YPP3_ALPHA_31 = 0, /* kg m2 */
  YPP3_ALPHA_21 = 1, /* kg m2 */
  YPP3_ALPHA_22 = 2, /* kg m2 */
  YPP3_ALPHA_11 = 3, /* kg m2 */
  YPP3_ALPHA_12 = 4, /* kg m2 */
  YPP3_ALPHA_13 = 5 /* kg m2 */
};

/* The constants of the URDF's own masses and inertias. */
extern const double ypp3_alpha_cad[YPP3_D];

/* J_diag[i]: inertia that joint i feels, the other joints held */
void ypp3_J_diag(const double q[YPP3_N], const double alpha[YPP3_D], double J_diag[YPP3_N]);

/* J[i][j]: the inertia matrix, symmetric */
void ypp3_J(const double q[YPP3_N], const double alpha[YPP3_D], double J[YPP3_N][YPP3_N]);

/* C_rows[i][k]: J_diag[i] is the sum over k of C_rows[i][k] alpha[k] */
void ypp3_C_rows(const double q[YPP3_N], double C_rows[YPP3_N][YPP3_D_DIAG]);

/* dJ_dq[k][i][j]: derivative of J[i][j] with respect to q[k] */
void ypp3_dJ_dq(const double q[YPP3_N], const double alpha[YPP3_D], double dJ_dq[YPP3_N][YPP3_N][YPP3_N]);

/* regressor[i][j][k]: J[i][j] is the sum over k of regressor[i][j][k] alpha[k] */
void ypp3_regressor(const double q[YPP3_N], double regressor[YPP3_N][YPP3_N][YPP3_D]);

#ifdef __cplusplus
}
#endif

#endif
