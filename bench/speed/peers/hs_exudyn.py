#!/usr/bin/env python3
"""Exudyn: q=[e, eta_1..N] (e = penetration = x - phi.eta) so that the contact force acts on ONE coordinate:
 constant full mass matrix [[m, m phi'],[m phi, I + m phi phi']], diagonal K, D on eta; contact = CoordinateSpringDamper with user function
 (plain Python, or Exudyn 'symbolic' function = expression tree evaluated in C++). usage: hs_exudyn.py KIND SOLVER DT_or_TOL N XI"""
import sys,json,time,math,os
clock = time.process_time if os.environ.get('CLOCK') == 'cpu' else time.perf_counter
import numpy as np
import exudyn as exu
from exudyn.utilities import *
import exudyn.graphics as gr
from hs_py import string,force,m,v0,alpha,aL,bL,cL,aU,bU,cU
kind,solver,dt,N,xi=sys.argv[1],sys.argv[2],float(sys.argv[3]),int(sys.argv[4]),float(sys.argv[5])
HERE=os.path.join(os.path.dirname(os.path.abspath(__file__)),os.pardir,'reference'); w,phi=string(N); esym=exu.symbolic
SC=exu.SystemContainer(); mbs=SC.AddSystem(); n=N+1
M=np.zeros((n,n)); M[0,0]=m; M[0,1:]=M[1:,0]=m*phi; M[1:,1:]=np.eye(N)+m*np.outer(phi,phi)
K=np.zeros((n,n)); K[1:,1:]=np.diag(w*w); D=np.zeros((n,n)); D[1:,1:]=np.diag(2*xi*w)
node=mbs.AddNode(NodeGenericODE2(referenceCoordinates=[0.]*n,initialCoordinates=[0.]*n,initialCoordinates_t=[v0]+[0.]*N,numberOfODE2Coordinates=n))
mbs.AddObject(ObjectGenericODE2(nodeNumbers=[node],massMatrix=M,stiffnessMatrix=K,dampingMatrix=D))
g=mbs.AddNode(NodePointGround()); mg=mbs.AddMarker(MarkerNodeCoordinate(nodeNumber=g,coordinate=0)); mc=mbs.AddMarker(MarkerNodeCoordinate(nodeNumber=node,coordinate=0))
calls=[0]
def ufp(mbs,t,i,u,v,k,d,off): calls[0]+=1; return force(u,v)
def ufs(mbs,t,i,u,v,k,d,off):
    FL=aL*u*esym.exp(bL*u)+cL*u; FU=aU*u*esym.exp(bU*u)+cU*u
    return esym.IfThenElse(u<=0.,esym.Real(0.),esym.IfThenElse(v>=0.,FL,FL+(FL-FU)*esym.tanh(alpha*v)))
co=mbs.AddObject(CoordinateSpringDamper(markerNumbers=[mg,mc],springForceUserFunction=ufp if kind=='python' else 0))
if kind=='symbolic':
    sf=CreateSymbolicUserFunction(mbs,ufs,"springForceUserFunction",co); mbs.SetObjectParameter(co,'springForceUserFunction',sf)
s=mbs.AddSensor(SensorNode(nodeNumber=node,storeInternal=True,outputVariableType=exu.OutputVariableType.Coordinates)); sv=mbs.AddSensor(SensorNode(nodeNumber=node,storeInternal=True,outputVariableType=exu.OutputVariableType.Coordinates_t))
mbs.Assemble(); S=exu.SimulationSettings(); ti=S.timeIntegration; ti.endTime=0.05; ti.verboseMode=0; S.solutionSettings.writeSolutionToFile=False; S.solutionSettings.sensorsWritePeriod=5e-5; 
ti.reuseConstantMassMatrix=True
st=getattr(exu.DynamicSolverType,solver)
if solver in('DOPRI5','ODE23','DVERK6'):
    ti.automaticStepSize=True; ti.relativeTolerance=dt; ti.absoluteTolerance=float(sys.argv[6]) if len(sys.argv)>6 else dt; ti.numberOfSteps=1000; ti.minimumStepSize=1e-10; ti.initialStepSize=1e-8
else:
    ti.numberOfSteps=int(round(0.05/dt)); ti.newton.useModifiedNewton=True
    if solver=='GeneralizedAlpha': ti.generalizedAlpha.spectralRadius=float(os.environ.get('RHO','0.9'))
t0=clock(); ok=True; note=''
try: mbs.SolveDynamic(S,solverType=st)
except Exception as ex: ok=False; note=str(ex)[-200:]
T=clock()-t0
q=mbs.GetSensorStoredData(s); qd=mbs.GetSensorStoredData(sv); ref=np.genfromtxt(f'{HERE}/ref_N{N}_xi{xi:g}.csv',delimiter=',',names=True)
idx=np.clip(np.round(q[:,0]/5e-5).astype(int),0,1000); e=q[:,1]; xs=q[:,2:]@phi; x=e+xs; F=np.array([force(a,b) for a,b in zip(e,qd[:,1])]); v=qd[:,1]+qd[:,2:]@phi
r=dict(engine=f'exudyn-{kind}-{solver}',N=N,xi=xi,dt=dt,ms=T*1e3,ok=ok,note=note,nout=len(q),calls=calls[0],err_x=float(np.abs(x-ref['x'][idx]).max()),err_F=float(np.abs(F-ref['F'][idx]).max()/ref['F'].max()),err_v=float(abs(v[-1]-ref['v'][-1])))
try: r['steps']=int(mbs.sys['dynamicSolver'].it.currentStepIndex); r['newton']=int(mbs.sys['dynamicSolver'].it.newtonStepsCount)
except Exception as ex: r['steps']=str(ex)[:60]
print(json.dumps(r))
