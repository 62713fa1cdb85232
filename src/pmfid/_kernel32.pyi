from pmfid._kernel64 import EdgeKernel as EdgeKernel
from pmfid._kernel64 import Kernel as Kernel
from pmfid._kernel64 import ManyKernel as ManyKernel
from pmfid._kernel64 import simulate as simulate
