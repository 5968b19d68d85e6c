#define SGM_ISA neon
#include "simd_neon.h"
#include "kernel.inl"

namespace sgm {
extern const Kernel kernel_neon;
const Kernel kernel_neon = {"neon", neon::V::N, neon::sweep<1>, neon::sweep<-1>};
}  // namespace sgm
