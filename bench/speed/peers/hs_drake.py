#!/usr/bin/env python3
"""Drake: Python LeafSystem with continuous state, error-controlled integrators. usage: hs_drake.py SCHEME ACC N XI"""
import sys,json,time,os
clock = time.process_time if os.environ.get('CLOCK') == 'cpu' else time.perf_counter
import numpy as np
from pydrake.systems.framework import LeafSystem, BasicVector
from pydrake.systems.analysis import Simulator, ResetIntegratorFromFlags, ApplySimulatorConfig, SimulatorConfig
from hs_py import string,force,m,v0
sch,acc,N,xi=sys.argv[1],float(sys.argv[2]),int(sys.argv[3]),float(sys.argv[4]); HERE=os.path.join(os.path.dirname(os.path.abspath(__file__)),os.pardir,'reference'); w,phi=string(N); w2=w*w; c2=2*xi*w; n=2*N+2; cnt=[0]
class S(LeafSystem):
    def __init__(s):
        LeafSystem.__init__(s); s.DeclareContinuousState(N+1,N+1,0)
    def DoCalcTimeDerivatives(s,ctx,der):
        cnt[0]+=1; y=ctx.get_continuous_state_vector().CopyToVector(); eta=y[1:1+N]; ed=y[2+N:]; F=force(y[0]-phi@eta,y[1+N]-phi@ed)
        f=np.empty(n); f[0]=y[1+N]; f[1:1+N]=ed; f[1+N]=-F/m; f[2+N:]=phi*F-c2*ed-w2*eta; der.get_mutable_vector().SetFromVector(f)
s=S(); sim=Simulator(s); ApplySimulatorConfig(SimulatorConfig(integration_scheme=sch,max_step_size=5e-5,accuracy=acc,use_error_control=True),sim)
ctx=sim.get_mutable_context(); y0=np.zeros(n); y0[1+N]=v0; ctx.SetContinuousState(y0); sim.Initialize(); Y=np.zeros((1001,n)); Y[0]=y0; t0=clock(); k=0
for k in range(1,1001):
    sim.AdvanceTo(k*5e-5); Y[k]=ctx.get_continuous_state_vector().CopyToVector()
    if clock()-t0>100: break
T=clock()-t0; ref=np.genfromtxt(f'{HERE}/ref_N{N}_xi{xi:g}.csv',delimiter=',',names=True); xs=Y[:,1:1+N]@phi; F=np.array([force(a,b) for a,b in zip(Y[:,0]-xs,Y[:,1+N]-Y[:,2+N:]@phi)])
I=sim.get_integrator(); j=k+1
print(json.dumps(dict(engine=f'drake-{sch}',N=N,xi=xi,rtol=acc,ms=T*1e3,t_reached=k*5e-5,rhs=cnt[0],steps=I.get_num_steps_taken(),err_x=float(np.abs(Y[:j,0]-ref['x'][:j]).max()),err_F=float(np.abs(F[:j]-ref['F'][:j]).max()/ref['F'].max()),err_v=float(abs(Y[k,1+N]-ref['v'][k])))))
