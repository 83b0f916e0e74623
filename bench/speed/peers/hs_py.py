#!/usr/bin/env python3
"""hammer-string benchmark, Python-side engines. usage: hs_py.py ENGINE N XI [RTOL ATOL] ; prints one JSON line."""
import sys, time, json, math, os
clock = time.process_time if os.environ.get('CLOCK') == 'cpu' else time.perf_counter
import numpy as np
HERE=os.path.join(os.path.dirname(os.path.abspath(__file__)),os.pardir,'reference')
m,v0,alpha=9e-3,3.0,10.0
aL,bL,cL,aU,bU,cU=2.35e4,1.74e3,-2.41e4,2.0e3,4.52e3,-0.82e3
def string(N):
    d,T,L,mu,E=0.99e-3,654.,0.6315,5.98e-3,2e11; j=np.arange(1,N+1)
    eps=math.pi*d**4*E/(64*L*L*T); w=math.pi*j/L*np.sqrt(T/mu*(1+eps*math.pi**2*j**2))
    return w, math.sqrt(2/(mu*L))*np.sin(j*math.pi/8)
def force(e,ve):
    if e<=0: return 0.0
    FL=aL*e*math.exp(bL*e)+cL*e
    if ve>=0: return FL
    FU=aU*e*math.exp(bU*e)+cU*e
    return FL+(FL-FU)*math.tanh(alpha*ve)
class Timeout(Exception): pass
def main():
    eng=sys.argv[1]; N=int(sys.argv[2]); xi=float(sys.argv[3]); rtol=float(sys.argv[4]) if len(sys.argv)>4 else 1e-6; atol=float(sys.argv[5]) if len(sys.argv)>5 else rtol
    LIM=float(os.environ.get('LIM','240')); reps=int(os.environ.get('REPS','3'))
    w,phi=string(N); w2=w*w; c2=2*xi*w; n=2*N+2; tg=np.arange(1001)*5e-5
    ref=np.genfromtxt(f'{HERE}/ref_N{N}_xi{xi:g}.csv',delimiter=',',names=True)
    y0=np.zeros(n); y0[1+N]=v0; cnt=[0]; t_lim=[clock()+LIM]
    def rhs_np(t,y):
        cnt[0]+=1
        if not cnt[0]&255 and clock()>t_lim[0]: raise Timeout
        eta=y[1:1+N]; ed=y[2+N:]; F=force(y[0]-phi@eta,y[1+N]-phi@ed)
        f=np.empty(n); f[0]=y[1+N]; f[1:1+N]=ed; f[1+N]=-F/m; f[2+N:]=phi*F-c2*ed-w2*eta; return f
    def mk_numba():
        import numba as nb
        P=np.concatenate([phi,w2,c2])
        @nb.njit(cache=False,fastmath=True,error_model='numpy')
        def core(y,f,P):
            N=P.size//3; xs=0.0; vs=0.0
            for j in range(N): xs+=P[j]*y[1+j]
            for j in range(N): vs+=P[j]*y[2+N+j]
            e=y[0]-xs; ve=y[1+N]-vs; F=0.0
            if e>0:
                F=aL*e*math.exp(bL*e)+cL*e
                if ve<0: F=F+(F-(aU*e*math.exp(bU*e)+cU*e))*math.tanh(alpha*ve)
            f[0]=y[1+N]; f[1+N]=-F/m
            for j in range(N):
                f[1+j]=y[2+N+j]; f[2+N+j]=P[j]*F-P[2*N+j]*y[2+N+j]-P[N+j]*y[1+j]
        core(y0,np.empty(n),P); return core,P
    res=dict(engine=eng,N=N,xi=xi,rtol=rtol,atol=atol); extra={}
    def finish(Y,best): # Y (1001,n)
        x=Y[:,0]; v=Y[:,1+N]; xs=Y[:,1:1+N]@phi; F=np.array([force(a,b) for a,b in zip(x-xs,v-Y[:,2+N:]@phi)])
        res.update(ms=best*1e3,err_x=float(np.abs(x-ref['x']).max()),err_F=float(np.abs(F-ref['F']).max()/ref['F'].max()),err_v=float(abs(v[-1]-ref['v'][-1])),**extra); print(json.dumps(res),flush=True)
    best=1e99; Y=None
    def timed(fn):
        nonlocal best
        out=None
        for r in range(reps):
            cnt[0]=0; t_lim[0]=clock()+LIM; t0=clock(); out=fn(); dt=clock()-t0; best=min(best,dt)
            if dt>10: break
        return out
    try:
        if eng.startswith('scipy'):
            from scipy.integrate import solve_ivp
            _,meth,kind=eng.split('-')
            if kind=='numpy': fun=rhs_np
            else:
                core,P=mk_numba()
                def fun(t,y):
                    cnt[0]+=1
                    if not cnt[0]&255 and clock()>t_lim[0]: raise Timeout
                    f=np.empty(n); core(y,f,P); return f
            s=timed(lambda: solve_ivp(fun,(0,0.05),y0,method=meth,t_eval=tg,rtol=rtol,atol=atol)); extra.update(rhs=cnt[0],ok=bool(s.success),nlu=int(s.nlu))
            t0=clock(); [fun(0,y0) for _ in range(2000)]; extra['rhs_us']=(clock()-t0)/2000*1e6
            finish(s.y.T,best)
        elif eng.startswith('sksundae'):
            import sksundae
            core,P=mk_numba(); meth='Adams' if 'adams' in eng else 'BDF'
            def fun(t,y,yp): 
                cnt[0]+=1; core(y,yp,P)
            kw={}
            if 'jac' in eng:
                import numba as nb
                @nb.njit(fastmath=True)
                def jc(y,J,P):
                    N=P.size//3; xs=0.;vs=0.
                    for j in range(N): xs+=P[j]*y[1+j]; vs+=P[j]*y[2+N+j]
                    e=y[0]-xs; ve=y[1+N]-vs; Fe=0.;Fv=0.
                    if e>0:
                        xL=math.exp(bL*e); FL=aL*e*xL+cL*e; Fe=aL*xL*(1+bL*e)+cL
                        if ve<0:
                            xU=math.exp(bU*e); FU=aU*e*xU+cU*e; dU=aU*xU*(1+bU*e)+cU; t=math.tanh(alpha*ve); Fe=Fe+(Fe-dU)*t; Fv=(FL-FU)*alpha*(1-t*t)
                    J[:]=0; iv=1+N; J[0,iv]=1; J[iv,0]=-Fe/m; J[iv,iv]=-Fv/m
                    for k in range(N):
                        J[iv,1+k]=Fe*P[k]/m; J[iv,iv+1+k]=Fv*P[k]/m; J[1+k,iv+1+k]=1.
                        J[iv+1+k,0]=P[k]*Fe; J[iv+1+k,iv]=P[k]*Fv
                        for l in range(N): J[iv+1+k,1+l]=-P[k]*P[l]*Fe; J[iv+1+k,iv+1+l]=-P[k]*P[l]*Fv
                        J[iv+1+k,1+k]-=P[N+k]; J[iv+1+k,iv+1+k]-=P[2*N+k]
                jc(y0,np.zeros((n,n)),P)
                kw['jacfn']=lambda t,y,yp,J: jc(y,J,P)
            if meth=='Adams': pass
            if 'gmres' in eng: kw['linsolver']='gmres'
            s=timed(lambda: sksundae.cvode.CVODE(fun,method=meth,rtol=rtol,atol=atol,max_num_steps=10**7,**kw).solve(tg,y0)); extra.update(rhs=int(getattr(s,'nfev',cnt[0])),rhs_calls=cnt[0],njev=int(getattr(s,'njev',-1) or -1),ver=sksundae.__version__)
            finish(np.asarray(s.y),best)
        elif eng.startswith('numbalsoda'):
            import numbalsoda as ns, numba as nb
            phl=phi.copy();w2l=w2.copy();c2l=c2.copy()
            @nb.cfunc(ns.lsoda_sig,fastmath=True)
            def f(t,y_,f_,p):
                y=nb.carray(y_,(n,)); f=nb.carray(f_,(n,)); q=nb.carray(p,(3*N+1,)); q[3*N]+=1.
                xs=0.;vs=0.
                for j in range(N): xs+=q[j]*y[1+j]; vs+=q[j]*y[2+N+j]
                e=y[0]-xs; ve=y[1+N]-vs; F=0.
                if e>0:
                    F=aL*e*math.exp(bL*e)+cL*e
                    if ve<0: F=F+(F-(aU*e*math.exp(bU*e)+cU*e))*math.tanh(alpha*ve)
                f[0]=y[1+N]; f[1+N]=-F/m
                for j in range(N):
                    f[1+j]=y[2+N+j]; f[2+N+j]=q[j]*F-q[2*N+j]*y[2+N+j]-q[N+j]*y[1+j]
            P=np.concatenate([phi,w2,c2,[0.]]); fn=ns.lsoda if eng.endswith('lsoda') else ns.dop853
            def go(): P[-1]=0; return fn(f.address,y0,tg,data=P,rtol=rtol,atol=atol,mxstep=10**7) if 'lsoda' in eng and eng.endswith('lsoda') else fn(f.address,y0,tg,data=P,rtol=rtol,atol=atol,mxstep=10**7)
            Yv,ok=timed(go); extra.update(rhs=int(P[-1]),ok=bool(ok)); finish(Yv,best)
        elif eng.startswith('casadi'):
            import casadi as ca
            y=ca.SX.sym('y',n); xs=ca.dot(phi,y[1:1+N]); vs=ca.dot(phi,y[2+N:]); e=y[0]-xs; ve=y[1+N]-vs
            FL=aL*e*ca.exp(bL*e)+cL*e; FU=aU*e*ca.exp(bU*e)+cU*e; F=ca.if_else(e<=0,0,ca.if_else(ve>=0,FL,FL+(FL-FU)*ca.tanh(alpha*ve)))
            ode=ca.vertcat(y[1+N],y[2+N:],-F/m,phi*F-c2*y[2+N:]-w2*y[1:1+N]); opts={'reltol':rtol,'abstol':atol,'max_num_steps':10**7}
            if 'jit' in eng: opts.update({'jit':True,'compiler':'shell','jit_options':{'flags':['-O3','-march=native','-ffast-math'],'verbose':False}})
            if 'iter' in eng: opts['newton_scheme']='gmres'
            t0=clock(); I=ca.integrator('I','cvodes',{'x':y,'ode':ode},0.0,tg[1:].tolist(),opts); extra['setup_ms']=(clock()-t0)*1e3
            r=timed(lambda: I(x0=y0)); st=I.stats(); extra.update({k:st[k] for k in ('nsteps','nfevals','nlinsetups') if k in st}); extra['rhs']=st.get('nfevals')
            finish(np.vstack([y0,np.array(r['xf']).T]),best)
    except Timeout:
        res.update(ms=None,note=f'over {LIM} s',rhs=cnt[0]); print(json.dumps(res),flush=True)
    except Exception as ex:
        res.update(ms=None,note=repr(ex)[:300]); print(json.dumps(res),flush=True)
if __name__=='__main__': main()
