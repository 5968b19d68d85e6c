#define SGM_ISA sse41
#include "simd_x86.h"
#include "kernel.inl"

namespace sgm {
extern const Kernel kernel_sse41;
const Kernel kernel_sse41 = {"sse41", sse41::V::N, sse41::sweep<1>, sse41::sweep<-1>};
}  // namespace sgm
