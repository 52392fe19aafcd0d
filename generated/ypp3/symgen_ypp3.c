/* Inertia matrix J(q) of the robot ypp3.
 * Written by symgen 0.1.0 with CasADi 3.8.2 from the URDF with SHA-256
 * 77a56c1ef1844153c423ab75a5e50ef58ac6b83d021e72517f7fbbdac28ce5c1
 * Written by a program: change the URDF, not this file. */

#include "symgen_ypp3.h"

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif
/* How to prefix internal symbols */
#ifdef CASADI_CODEGEN_PREFIX
  #define CASADI_NAMESPACE_CONCAT(NS, ID) _CASADI_NAMESPACE_CONCAT(NS, ID)
  #define _CASADI_NAMESPACE_CONCAT(NS, ID) NS ## ID
  #define CASADI_PREFIX(ID) CASADI_NAMESPACE_CONCAT(CODEGEN_PREFIX, ID)
#else
  #define CASADI_PREFIX(ID) symgen_ypp3_ ## ID
#endif

#include <math.h>

#ifndef casadi_real
#define casadi_real double
#endif

#ifndef casadi_int
#define casadi_int long long int
#endif

/* Add prefix to internal symbols */
#define casadi_f0 CASADI_PREFIX(f0)
#define casadi_f1 CASADI_PREFIX(f1)
#define casadi_f2 CASADI_PREFIX(f2)
#define casadi_f3 CASADI_PREFIX(f3)
#define casadi_f4 CASADI_PREFIX(f4)
#define casadi_s0 CASADI_PREFIX(s0)
#define casadi_s1 CASADI_PREFIX(s1)
#define casadi_s2 CASADI_PREFIX(s2)
#define casadi_s3 CASADI_PREFIX(s3)
#define casadi_s4 CASADI_PREFIX(s4)
#define casadi_s5 CASADI_PREFIX(s5)
#define casadi_sq CASADI_PREFIX(sq)

casadi_real casadi_sq(casadi_real x) { return x*x;}

/* Configuration this file was compiled with */
void symgen_ypp3_casadi_version(int* major, int* minor, int* patch) {
  *major = 3;
  *minor = 8;
  *patch = 2;
}
int symgen_ypp3_casadi_int_size(void) { return (int) sizeof(casadi_int); }
int symgen_ypp3_casadi_real_size(void) { return (int) sizeof(casadi_real); }

static const casadi_int casadi_s0[3] = {3, 1, 1};
static const casadi_int casadi_s1[3] = {6, 1, 1};
static const casadi_int casadi_s2[3] = {3, 3, 1};
static const casadi_int casadi_s3[3] = {6, 3, 1};
static const casadi_int casadi_s4[3] = {3, 9, 1};
static const casadi_int casadi_s5[3] = {6, 9, 1};

/* ypp3_J_diag_graph:(q[3],alpha[6])->(J_diag[3]) */
static int casadi_f0(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem) {
  casadi_real a0, a1, a2, a3, a4, a5, a6, a7, a8;
  a0=3.4999999999999998e-01;
  a1=arg[0][1];
  a2=cos(a1);
  a2=(a0*a2);
  a3=arg[0][2];
  a3=(a1+a3);
  a4=cos(a3);
  a5=2.8571428571428998e+00;
  a6=arg[1][1];
  a5=(a5*a6);
  a4=(a4*a5);
  a2=(a2*a4);
  a2=(2.*a2);
  a3=sin(a3);
  a4=arg[1][3];
  a6=(a3*a4);
  a6=(a3*a6);
  a6=(a2-a6);
  a1=sin(a1);
  a7=arg[1][4];
  a8=(a1*a7);
  a8=(a1*a8);
  a6=(a6-a8);
  a4=(a4+a7);
  a7=arg[1][5];
  a4=(a4+a7);
  a6=(a6+a4);
  res[0][0]=a6;
  a6=arg[1][0];
  a0=(a0*a1);
  a3=(a3*a5);
  a0=(a0*a3);
  a0=(2.*a0);
  a2=(a2+a0);
  a2=(a6+a2);
  a0=arg[1][2];
  a0=(a0-a6);
  a2=(a2+a0);
  res[0][1]=a2;
  res[0][2]=a6;
  return 0;
}

int ypp3_J_diag_graph(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem){
  return casadi_f0(arg, res, iw, w, mem);
}

int ypp3_J_diag_graph_checkout(void) {
  return 0;
}

void ypp3_J_diag_graph_release(int mem) {
}

void ypp3_J_diag_graph_incref(void) {
}

void ypp3_J_diag_graph_decref(void) {
}

casadi_int ypp3_J_diag_graph_n_in(void) { return 2;}

casadi_int ypp3_J_diag_graph_n_out(void) { return 1;}

casadi_real ypp3_J_diag_graph_default_in(casadi_int i) {
  switch (i) {
    default: return 0;
  }
}

const char* ypp3_J_diag_graph_name_in(casadi_int i) {
  switch (i) {
    case 0: return "q";
    case 1: return "alpha";
    default: return 0;
  }
}

const char* ypp3_J_diag_graph_name_out(casadi_int i) {
  switch (i) {
    case 0: return "J_diag";
    default: return 0;
  }
}

const casadi_int* ypp3_J_diag_graph_sparsity_in(casadi_int i) {
  switch (i) {
    case 0: return casadi_s0;
    case 1: return casadi_s1;
    default: return 0;
  }
}

const casadi_int* ypp3_J_diag_graph_sparsity_out(casadi_int i) {
  switch (i) {
    case 0: return casadi_s0;
    default: return 0;
  }
}

int ypp3_J_diag_graph_work(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
  if (sz_arg) *sz_arg = 2;
  if (sz_res) *sz_res = 1;
  if (sz_iw) *sz_iw = 0;
  if (sz_w) *sz_w = 0;
  return 0;
}

int ypp3_J_diag_graph_work_bytes(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
  if (sz_arg) *sz_arg = 2*sizeof(const casadi_real*);
  if (sz_res) *sz_res = 1*sizeof(casadi_real*);
  if (sz_iw) *sz_iw = 0*sizeof(casadi_int);
  if (sz_w) *sz_w = 0*sizeof(casadi_real);
  return 0;
}

/* ypp3_J_graph:(q[3],alpha[6])->(J[3x3]) */
static int casadi_f1(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem) {
  casadi_real a0, a1, a2, a3, a4, a5, a6, a7, a8, a9;
  a0=3.4999999999999998e-01;
  a1=arg[0][1];
  a2=cos(a1);
  a2=(a0*a2);
  a3=arg[0][2];
  a3=(a1+a3);
  a4=cos(a3);
  a5=2.8571428571428998e+00;
  a6=arg[1][1];
  a5=(a5*a6);
  a4=(a4*a5);
  a2=(a2*a4);
  a4=(2.*a2);
  a3=sin(a3);
  a6=arg[1][3];
  a7=(a3*a6);
  a7=(a3*a7);
  a7=(a4-a7);
  a1=sin(a1);
  a8=arg[1][4];
  a9=(a1*a8);
  a9=(a1*a9);
  a7=(a7-a9);
  a6=(a6+a8);
  a8=arg[1][5];
  a6=(a6+a8);
  a7=(a7+a6);
  res[0][0]=a7;
  a7=0.;
  res[0][1]=a7;
  res[0][2]=a7;
  res[0][3]=a7;
  a6=arg[1][0];
  a0=(a0*a1);
  a3=(a3*a5);
  a0=(a0*a3);
  a3=(2.*a0);
  a4=(a4+a3);
  a4=(a6+a4);
  a3=arg[1][2];
  a3=(a3-a6);
  a4=(a4+a3);
  res[0][4]=a4;
  a0=(a6+a0);
  a0=(a0+a2);
  res[0][5]=a0;
  res[0][6]=a7;
  res[0][7]=a0;
  res[0][8]=a6;
  return 0;
}

int ypp3_J_graph(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem){
  return casadi_f1(arg, res, iw, w, mem);
}

int ypp3_J_graph_checkout(void) {
  return 0;
}

void ypp3_J_graph_release(int mem) {
}

void ypp3_J_graph_incref(void) {
}

void ypp3_J_graph_decref(void) {
}

casadi_int ypp3_J_graph_n_in(void) { return 2;}

casadi_int ypp3_J_graph_n_out(void) { return 1;}

casadi_real ypp3_J_graph_default_in(casadi_int i) {
  switch (i) {
    default: return 0;
  }
}

const char* ypp3_J_graph_name_in(casadi_int i) {
  switch (i) {
    case 0: return "q";
    case 1: return "alpha";
    default: return 0;
  }
}

const char* ypp3_J_graph_name_out(casadi_int i) {
  switch (i) {
    case 0: return "J";
    default: return 0;
  }
}

const casadi_int* ypp3_J_graph_sparsity_in(casadi_int i) {
  switch (i) {
    case 0: return casadi_s0;
    case 1: return casadi_s1;
    default: return 0;
  }
}

const casadi_int* ypp3_J_graph_sparsity_out(casadi_int i) {
  switch (i) {
    case 0: return casadi_s2;
    default: return 0;
  }
}

int ypp3_J_graph_work(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
  if (sz_arg) *sz_arg = 2;
  if (sz_res) *sz_res = 1;
  if (sz_iw) *sz_iw = 0;
  if (sz_w) *sz_w = 0;
  return 0;
}

int ypp3_J_graph_work_bytes(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
  if (sz_arg) *sz_arg = 2*sizeof(const casadi_real*);
  if (sz_res) *sz_res = 1*sizeof(casadi_real*);
  if (sz_iw) *sz_iw = 0*sizeof(casadi_int);
  if (sz_w) *sz_w = 0*sizeof(casadi_real);
  return 0;
}

/* ypp3_C_rows_graph:(q[3])->(C_rows[6x3]) */
static int casadi_f2(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem) {
  casadi_real a0, a1, a2, a3, a4, a5, a6, a7;
  a0=0.;
  res[0][0]=a0;
  a1=3.4999999999999998e-01;
  a2=arg[0][1];
  a3=cos(a2);
  a3=(a1*a3);
  a4=2.8571428571428998e+00;
  a5=arg[0][2];
  a5=(a2+a5);
  a6=cos(a5);
  a6=(a4*a6);
  a3=(a3*a6);
  a3=(2.*a3);
  res[0][1]=a3;
  res[0][2]=a0;
  a6=1.;
  a5=sin(a5);
  a7=casadi_sq(a5);
  a7=(a6-a7);
  res[0][3]=a7;
  a2=sin(a2);
  a7=casadi_sq(a2);
  a7=(a6-a7);
  res[0][4]=a7;
  res[0][5]=a6;
  res[0][6]=a0;
  a1=(a1*a2);
  a4=(a4*a5);
  a1=(a1*a4);
  a1=(2.*a1);
  a3=(a3+a1);
  res[0][7]=a3;
  res[0][8]=a6;
  res[0][9]=a0;
  res[0][10]=a0;
  res[0][11]=a0;
  res[0][12]=a6;
  res[0][13]=a0;
  res[0][14]=a0;
  res[0][15]=a0;
  res[0][16]=a0;
  res[0][17]=a0;
  return 0;
}

int ypp3_C_rows_graph(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem){
  return casadi_f2(arg, res, iw, w, mem);
}

int ypp3_C_rows_graph_checkout(void) {
  return 0;
}

void ypp3_C_rows_graph_release(int mem) {
}

void ypp3_C_rows_graph_incref(void) {
}

void ypp3_C_rows_graph_decref(void) {
}

casadi_int ypp3_C_rows_graph_n_in(void) { return 1;}

casadi_int ypp3_C_rows_graph_n_out(void) { return 1;}

casadi_real ypp3_C_rows_graph_default_in(casadi_int i) {
  switch (i) {
    default: return 0;
  }
}

const char* ypp3_C_rows_graph_name_in(casadi_int i) {
  switch (i) {
    case 0: return "q";
    default: return 0;
  }
}

const char* ypp3_C_rows_graph_name_out(casadi_int i) {
  switch (i) {
    case 0: return "C_rows";
    default: return 0;
  }
}

const casadi_int* ypp3_C_rows_graph_sparsity_in(casadi_int i) {
  switch (i) {
    case 0: return casadi_s0;
    default: return 0;
  }
}

const casadi_int* ypp3_C_rows_graph_sparsity_out(casadi_int i) {
  switch (i) {
    case 0: return casadi_s3;
    default: return 0;
  }
}

int ypp3_C_rows_graph_work(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
  if (sz_arg) *sz_arg = 1;
  if (sz_res) *sz_res = 1;
  if (sz_iw) *sz_iw = 0;
  if (sz_w) *sz_w = 0;
  return 0;
}

int ypp3_C_rows_graph_work_bytes(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
  if (sz_arg) *sz_arg = 1*sizeof(const casadi_real*);
  if (sz_res) *sz_res = 1*sizeof(casadi_real*);
  if (sz_iw) *sz_iw = 0*sizeof(casadi_int);
  if (sz_w) *sz_w = 0*sizeof(casadi_real);
  return 0;
}

/* ypp3_dJ_dq_graph:(q[3],alpha[6])->(dJ_dq[3x9]) */
static int casadi_f3(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem) {
  casadi_real a00, a01, a02, a03, a04, a05, a06, a07, a08, a09, a10, a11;
  casadi_real a12, a13, a14;
  a00=0.;
  res[0][0]=a00;
  res[0][1]=a00;
  res[0][2]=a00;
  res[0][3]=a00;
  res[0][4]=a00;
  res[0][5]=a00;
  res[0][6]=a00;
  res[0][7]=a00;
  res[0][8]=a00;
  a01=arg[0][1];
  a02=arg[0][2];
  a02=(a01+a02);
  a03=cos(a02);
  a04=2.8571428571428998e+00;
  a05=arg[1][1];
  a04=(a04*a05);
  a05=(a03*a04);
  a06=3.4999999999999998e-01;
  a07=sin(a01);
  a08=(a06*a07);
  a05=(a05*a08);
  a01=cos(a01);
  a06=(a06*a01);
  a02=sin(a02);
  a09=(a04*a02);
  a09=(a06*a09);
  a05=(a05+a09);
  a10=(-a05);
  a10=(2.*a10);
  a11=arg[1][3];
  a12=(a02*a11);
  a12=(a12*a03);
  a11=(a11*a03);
  a11=(a02*a11);
  a12=(a12+a11);
  a11=(a10-a12);
  a13=arg[1][4];
  a14=(a07*a13);
  a14=(a14*a01);
  a13=(a13*a01);
  a07=(a07*a13);
  a14=(a14+a07);
  a11=(a11-a14);
  res[0][9]=a11;
  res[0][10]=a00;
  res[0][11]=a00;
  res[0][12]=a00;
  a02=(a02*a04);
  a02=(a02*a06);
  a04=(a04*a03);
  a08=(a08*a04);
  a02=(a02+a08);
  a04=(2.*a02);
  a10=(a10+a04);
  res[0][13]=a10;
  a02=(a02-a05);
  res[0][14]=a02;
  res[0][15]=a00;
  res[0][16]=a02;
  res[0][17]=a00;
  a02=(-a09);
  a02=(2.*a02);
  a12=(a02-a12);
  res[0][18]=a12;
  res[0][19]=a00;
  res[0][20]=a00;
  res[0][21]=a00;
  a12=(2.*a08);
  a02=(a02+a12);
  res[0][22]=a02;
  a08=(a08-a09);
  res[0][23]=a08;
  res[0][24]=a00;
  res[0][25]=a08;
  res[0][26]=a00;
  return 0;
}

int ypp3_dJ_dq_graph(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem){
  return casadi_f3(arg, res, iw, w, mem);
}

int ypp3_dJ_dq_graph_checkout(void) {
  return 0;
}

void ypp3_dJ_dq_graph_release(int mem) {
}

void ypp3_dJ_dq_graph_incref(void) {
}

void ypp3_dJ_dq_graph_decref(void) {
}

casadi_int ypp3_dJ_dq_graph_n_in(void) { return 2;}

casadi_int ypp3_dJ_dq_graph_n_out(void) { return 1;}

casadi_real ypp3_dJ_dq_graph_default_in(casadi_int i) {
  switch (i) {
    default: return 0;
  }
}

const char* ypp3_dJ_dq_graph_name_in(casadi_int i) {
  switch (i) {
    case 0: return "q";
    case 1: return "alpha";
    default: return 0;
  }
}

const char* ypp3_dJ_dq_graph_name_out(casadi_int i) {
  switch (i) {
    case 0: return "dJ_dq";
    default: return 0;
  }
}

const casadi_int* ypp3_dJ_dq_graph_sparsity_in(casadi_int i) {
  switch (i) {
    case 0: return casadi_s0;
    case 1: return casadi_s1;
    default: return 0;
  }
}

const casadi_int* ypp3_dJ_dq_graph_sparsity_out(casadi_int i) {
  switch (i) {
    case 0: return casadi_s4;
    default: return 0;
  }
}

int ypp3_dJ_dq_graph_work(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
  if (sz_arg) *sz_arg = 2;
  if (sz_res) *sz_res = 1;
  if (sz_iw) *sz_iw = 0;
  if (sz_w) *sz_w = 0;
  return 0;
}

int ypp3_dJ_dq_graph_work_bytes(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
  if (sz_arg) *sz_arg = 2*sizeof(const casadi_real*);
  if (sz_res) *sz_res = 1*sizeof(casadi_real*);
  if (sz_iw) *sz_iw = 0*sizeof(casadi_int);
  if (sz_w) *sz_w = 0*sizeof(casadi_real);
  return 0;
}

/* ypp3_regressor_graph:(q[3])->(regressor[6x9]) */
static int casadi_f4(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem) {
  casadi_real a0, a1, a2, a3, a4, a5, a6, a7, a8;
  a0=0.;
  res[0][0]=a0;
  a1=3.4999999999999998e-01;
  a2=arg[0][1];
  a3=cos(a2);
  a3=(a1*a3);
  a4=2.8571428571428998e+00;
  a5=arg[0][2];
  a5=(a2+a5);
  a6=cos(a5);
  a6=(a4*a6);
  a3=(a3*a6);
  a6=(2.*a3);
  res[0][1]=a6;
  res[0][2]=a0;
  a7=1.;
  a5=sin(a5);
  a8=casadi_sq(a5);
  a8=(a7-a8);
  res[0][3]=a8;
  a2=sin(a2);
  a8=casadi_sq(a2);
  a8=(a7-a8);
  res[0][4]=a8;
  res[0][5]=a7;
  res[0][6]=a0;
  res[0][7]=a0;
  res[0][8]=a0;
  res[0][9]=a0;
  res[0][10]=a0;
  res[0][11]=a0;
  res[0][12]=a0;
  res[0][13]=a0;
  res[0][14]=a0;
  res[0][15]=a0;
  res[0][16]=a0;
  res[0][17]=a0;
  res[0][18]=a0;
  res[0][19]=a0;
  res[0][20]=a0;
  res[0][21]=a0;
  res[0][22]=a0;
  res[0][23]=a0;
  res[0][24]=a0;
  a1=(a1*a2);
  a4=(a4*a5);
  a1=(a1*a4);
  a4=(2.*a1);
  a6=(a6+a4);
  res[0][25]=a6;
  res[0][26]=a7;
  res[0][27]=a0;
  res[0][28]=a0;
  res[0][29]=a0;
  res[0][30]=a7;
  a1=(a1+a3);
  res[0][31]=a1;
  res[0][32]=a0;
  res[0][33]=a0;
  res[0][34]=a0;
  res[0][35]=a0;
  res[0][36]=a0;
  res[0][37]=a0;
  res[0][38]=a0;
  res[0][39]=a0;
  res[0][40]=a0;
  res[0][41]=a0;
  res[0][42]=a7;
  res[0][43]=a1;
  res[0][44]=a0;
  res[0][45]=a0;
  res[0][46]=a0;
  res[0][47]=a0;
  res[0][48]=a7;
  res[0][49]=a0;
  res[0][50]=a0;
  res[0][51]=a0;
  res[0][52]=a0;
  res[0][53]=a0;
  return 0;
}

int ypp3_regressor_graph(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem){
  return casadi_f4(arg, res, iw, w, mem);
}

int ypp3_regressor_graph_checkout(void) {
  return 0;
}

void ypp3_regressor_graph_release(int mem) {
}

void ypp3_regressor_graph_incref(void) {
}

void ypp3_regressor_graph_decref(void) {
}

casadi_int ypp3_regressor_graph_n_in(void) { return 1;}

casadi_int ypp3_regressor_graph_n_out(void) { return 1;}

casadi_real ypp3_regressor_graph_default_in(casadi_int i) {
  switch (i) {
    default: return 0;
  }
}

const char* ypp3_regressor_graph_name_in(casadi_int i) {
  switch (i) {
    case 0: return "q";
    default: return 0;
  }
}

const char* ypp3_regressor_graph_name_out(casadi_int i) {
  switch (i) {
    case 0: return "regressor";
    default: return 0;
  }
}

const casadi_int* ypp3_regressor_graph_sparsity_in(casadi_int i) {
  switch (i) {
    case 0: return casadi_s0;
    default: return 0;
  }
}

const casadi_int* ypp3_regressor_graph_sparsity_out(casadi_int i) {
  switch (i) {
    case 0: return casadi_s5;
    default: return 0;
  }
}

int ypp3_regressor_graph_work(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
  if (sz_arg) *sz_arg = 1;
  if (sz_res) *sz_res = 1;
  if (sz_iw) *sz_iw = 0;
  if (sz_w) *sz_w = 0;
  return 0;
}

int ypp3_regressor_graph_work_bytes(casadi_int *sz_arg, casadi_int* sz_res, casadi_int *sz_iw, casadi_int *sz_w) {
  if (sz_arg) *sz_arg = 1*sizeof(const casadi_real*);
  if (sz_res) *sz_res = 1*sizeof(casadi_real*);
  if (sz_iw) *sz_iw = 0*sizeof(casadi_int);
  if (sz_w) *sz_w = 0*sizeof(casadi_real);
  return 0;
}
#if defined(__GNUC__)
#pragma GCC diagnostic pop
#endif

const double ypp3_alpha_cad[YPP3_D] = {
  0.046599999999847,
  0.092849999999977,
  0.5071999999998,
  0.043399999999847,
  0.45439999999995,
  0.0152,
};

void ypp3_J_diag(const double q[YPP3_N], const double alpha[YPP3_D], double J_diag[YPP3_N])
{
  const double *arg[2];
  double *res[1];
  arg[0] = q;
  arg[1] = alpha;
  res[0] = J_diag;
  ypp3_J_diag_graph(arg, res, 0, 0, 0);
}

void ypp3_J(const double q[YPP3_N], const double alpha[YPP3_D], double J[YPP3_N][YPP3_N])
{
  const double *arg[2];
  double *res[1];
  arg[0] = q;
  arg[1] = alpha;
  res[0] = J[0];
  ypp3_J_graph(arg, res, 0, 0, 0);
}

void ypp3_C_rows(const double q[YPP3_N], double C_rows[YPP3_N][YPP3_D_DIAG])
{
  const double *arg[1];
  double *res[1];
  arg[0] = q;
  res[0] = C_rows[0];
  ypp3_C_rows_graph(arg, res, 0, 0, 0);
}

void ypp3_dJ_dq(const double q[YPP3_N], const double alpha[YPP3_D], double dJ_dq[YPP3_N][YPP3_N][YPP3_N])
{
  const double *arg[2];
  double *res[1];
  arg[0] = q;
  arg[1] = alpha;
  res[0] = dJ_dq[0][0];
  ypp3_dJ_dq_graph(arg, res, 0, 0, 0);
}

void ypp3_regressor(const double q[YPP3_N], double regressor[YPP3_N][YPP3_N][YPP3_D])
{
  const double *arg[1];
  double *res[1];
  arg[0] = q;
  res[0] = regressor[0][0];
  ypp3_regressor_graph(arg, res, 0, 0, 0);
}
