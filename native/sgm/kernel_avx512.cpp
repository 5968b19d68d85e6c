#define SGM_ISA avx512
#include "simd_avx512.h"
#include "kernel.inl"

namespace sgm {
extern const Kernel kernel_avx512;
const Kernel kernel_avx512 = {"avx512", avx512::V::N, avx512::sweep<1>, avx512::sweep<-1>};
}  // namespace sgm
