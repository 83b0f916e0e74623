#!/usr/bin/env python3
"""MuJoCo: each mode = unit-mass body on a slide joint (stiffness w^2, damping 2 xi w), hammer = slide joint. Force law is not available natively:
 applied by mjcb_passive (Python callback) [mode cb] or through qfrc_applied before each mj_step [mode loop]. Fixed step only. usage: hs_mujoco.py MODE INTEGRATOR DT N XI"""
import sys,json,time,os
clock = time.process_time if os.environ.get('CLOCK') == 'cpu' else time.perf_counter
import numpy as np, mujoco
from hs_py import string,force,m,v0
mode,integ,dt,N,xi=sys.argv[1],sys.argv[2],float(sys.argv[3]),int(sys.argv[4]),float(sys.argv[5])
HERE=os.path.join(os.path.dirname(os.path.abspath(__file__)),os.pardir,'reference'); w,phi=string(N)
B=''.join(f'<body><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><joint type="slide" axis="1 0 0" stiffness="{k*k:.17g}" damping="{2*xi*k:.17g}"/></body>' for k in w)
xml=f'<mujoco><option gravity="0 0 0" timestep="{dt}" integrator="{integ}"><flag contact="disable" constraint="disable"/></option><worldbody><body><inertial pos="0 0 0" mass="{m}" diaginertia="1 1 1"/><joint type="slide" axis="1 0 0"/></body>{B}</worldbody></mujoco>'
M=mujoco.MjModel.from_xml_string(xml); d=mujoco.MjData(M); d.qvel[0]=v0; calls=[0]; P=np.concatenate([[-1.0],phi])
def fc(q,v): calls[0]+=1; return force(q[0]-phi@q[1:],v[0]-phi@v[1:])
if mode=='cb':
    def cb(model,data): 
        F=fc(data.qpos,data.qvel)
        if F!=0: data.qfrc_passive[:]+=P*F
    mujoco.set_mjcb_passive(cb)
n=int(round(0.05/dt)); per=int(round(5e-5/dt)); Y=np.zeros((1001,4)); Y[0,1]=v0; q,v=d.qpos,d.qvel; t0=clock()
for k in range(n):
    if mode=='loop':
        F=fc(q,v)
        if F!=0: np.multiply(P,F,out=d.qfrc_applied)
        else: d.qfrc_applied[:]=0
    mujoco.mj_step(M,d)
    if (k+1)%per==0:
        i=(k+1)//per; xs=phi@q[1:]; Y[i]=q[0],v[0],xs,force(q[0]-xs,v[0]-phi@v[1:])
T=clock()-t0; ref=np.genfromtxt(f'{HERE}/ref_N{N}_xi{xi:g}.csv',delimiter=',',names=True)
mujoco.set_mjcb_passive(None)
d2=mujoco.MjData(M); t1=clock(); mujoco.mj_step(M,d2,2000); ts=(clock()-t1)/2000
print(json.dumps(dict(engine=f'mujoco-{mode}-{integ}',N=N,xi=xi,dt=dt,ms=T*1e3,steps=n,calls=calls[0],native_step_us=ts*1e6,err_x=float(np.abs(Y[:,0]-ref['x']).max()),err_F=float(np.abs(Y[:,3]-ref['F']).max()/ref['F'].max()),err_v=float(abs(Y[-1,1]-ref['v'][-1])))))
