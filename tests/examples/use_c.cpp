// J(q) of the paper's arm in C++, with the constants of its URDF:
//   gcc -std=c99 -O2 -c generated/ypp3/symgen_ypp3.c
//   g++ -std=c++17 -O2 -Igenerated/ypp3 tests/examples/use_c.cpp symgen_ypp3.o -o use_c
//   ./use_c 0 0.5 -1.2
#include "symgen_ypp3.h"

#include <cstdio>
#include <cstdlib>

int main(int count, char **words) {
    if (count != 1 + YPP3_N) {
        std::fprintf(stderr, "usage: %s q1 .. q%d [rad]\n", words[0], YPP3_N);
        return 2;
    }
    double q[YPP3_N], J[YPP3_N][YPP3_N];
    for (int k = 0; k < YPP3_N; ++k) {
        q[k] = std::atof(words[1 + k]);
    }
    ypp3_J(q, ypp3_alpha_cad, J);
    for (const auto &row : J) {
        for (double entry : row) {
            std::printf("%.17g ", entry);
        }
        std::printf("\n");
    }
}
