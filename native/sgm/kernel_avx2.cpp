#define SGM_ISA avx2
#include "simd_avx2.h"
#include "kernel.inl"

namespace sgm {
extern const Kernel kernel_avx2;
const Kernel kernel_avx2 = {"avx2", avx2::V::N, avx2::sweep<1>, avx2::sweep<-1>};
}  // namespace sgm
