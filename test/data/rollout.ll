define internal void @body_momentum(ptr %q, ptr %qd, ptr %qdd, ptr %out) {
entry:
  %v1 = load double, ptr %qdd, align 8
  %v2 = getelementptr double, ptr %q, i64 1
  %v3 = load double, ptr %v2, align 8
  %v4 = fmul double %v1, %v3
  %v5 = load double, ptr %qd, align 8
  %v6 = getelementptr double, ptr %qd, i64 1
  %v7 = load double, ptr %v6, align 8
  %v8 = fmul double %v5, %v7
  %v9 = call double @llvm.fma.f64(double 0x4000000000000000, double %v8, double %v4)
  %v10 = fmul double 0x3FF9000000000000, %v1
  %v11 = fmul double %v5, %v5
  %v12 = call double @llvm.fma.f64(double 0x3FF4000000000000, double %v9, double %v10)
  %v13 = call double @llvm.fma.f64(double %v1, double 0x3FF4000000000000, double %v9)
  %v14 = call double @llvm.fma.f64(double %v3, double %v13, double %v12)
  %v15 = fneg double %v11
  %v16 = getelementptr double, ptr %qdd, i64 1
  %v17 = load double, ptr %v16, align 8
  %v18 = call double @llvm.fma.f64(double %v15, double %v3, double %v17)
  %v19 = call double @llvm.fma.f64(double %v15, double 0x3FF4000000000000, double %v18)
  %v20 = call double @llvm.fma.f64(double 0x4004000000000000, double %v1, double %v14)
  store double %v20, ptr %out, align 8
  %v21 = getelementptr double, ptr %out, i64 1
  store double %v19, ptr %v21, align 8
  ret void
}

define internal void @body_inertial(ptr %q, ptr %qd, ptr %tau, ptr %free, ptr %out) {
entry:
  %v1 = getelementptr double, ptr %q, i64 1
  %v2 = load double, ptr %v1, align 8
  %v3 = fsub double 0xC004000000000000, %v2
  %v4 = load double, ptr %qd, align 8
  %v5 = fmul double %v4, %v4
  %v6 = getelementptr double, ptr %qd, i64 1
  %v7 = load double, ptr %v6, align 8
  %v8 = fmul double %v4, %v7
  %v9 = fneg double %v2
  %v10 = call double @llvm.fma.f64(double %v9, double %v3, double 0x3FF9000000000000)
  %v11 = fmul double %v5, 0x3FF4000000000000
  %v12 = call double @llvm.fma.f64(double %v5, double %v2, double %v11)
  %v13 = fadd double 0x4004000000000000, %v10
  %v14 = fmul double 0x4000000000000000, %v8
  %v15 = fmul double 0x4004000000000000, %v8
  %v16 = call double @llvm.fma.f64(double %v2, double %v14, double %v15)
  %v17 = fdiv double 0x3FF0000000000000, %v13
  %v18 = getelementptr double, ptr %tau, i64 1
  %v19 = load double, ptr %v18, align 8
  %v20 = fadd double %v19, %v12
  %v21 = getelementptr double, ptr %free, i64 1
  %v22 = load double, ptr %v21, align 8
  %v23 = fcmp ogt double %v22, 0x0000000000000000
  %v24 = select i1 %v23, double 0x3FF0000000000000, double 0x0000000000000000
  %v25 = fmul double %v20, %v24
  %v26 = load double, ptr %tau, align 8
  %v27 = fsub double %v26, %v16
  %v28 = fcmp ogt double %v22, 0x0000000000000000
  %v29 = select i1 %v28, double %v25, double 0x0000000000000000
  %v30 = load double, ptr %free, align 8
  %v31 = fcmp ogt double %v30, 0x0000000000000000
  %v32 = select i1 %v31, double %v17, double 0x0000000000000000
  %v33 = fmul double %v27, %v32
  %v34 = fcmp ogt double %v30, 0x0000000000000000
  %v35 = select i1 %v34, double %v33, double 0x0000000000000000
  store double %v35, ptr %out, align 8
  %v36 = getelementptr double, ptr %out, i64 1
  store double %v29, ptr %v36, align 8
  ret void
}

define void @evaluate_momentum(ptr %q, ptr %qd, ptr %qdd, ptr %out) {
entry:
  %a1 = alloca [2 x double], align 64
  %v2 = load double, ptr %q, align 8
  %v3 = call double @llvm.fma.f64(double %v2, double %v2, double 0x0000000000000000)
  %v4 = fcmp ugt double %v3, 0x4202A05F20000000
  br i1 %v4, label %then5, label %after6, !prof !0
then5:
  %v7 = load double, ptr %q, align 8
  store double %v7, ptr %a1, align 8
  call void @wrap_row(ptr %a1)
  %v8 = getelementptr double, ptr %q, i64 1
  %v9 = load double, ptr %v8, align 8
  %v10 = getelementptr double, ptr %a1, i64 1
  store double %v9, ptr %v10, align 8
  br label %after6
after6:
  %v11 = phi ptr [ %a1, %then5 ], [ %q, %entry ]
  call void @body_momentum(ptr %v11, ptr %qd, ptr %qdd, ptr %out)
  ret void
}

define void @evaluate_inertial(ptr %q, ptr %qd, ptr %tau, ptr %free, ptr %out) {
entry:
  %a1 = alloca [2 x double], align 64
  %v2 = load double, ptr %q, align 8
  %v3 = call double @llvm.fma.f64(double %v2, double %v2, double 0x0000000000000000)
  %v4 = fcmp ugt double %v3, 0x4202A05F20000000
  br i1 %v4, label %then5, label %after6, !prof !0
then5:
  %v7 = load double, ptr %q, align 8
  store double %v7, ptr %a1, align 8
  call void @wrap_row(ptr %a1)
  %v8 = getelementptr double, ptr %q, i64 1
  %v9 = load double, ptr %v8, align 8
  %v10 = getelementptr double, ptr %a1, i64 1
  store double %v9, ptr %v10, align 8
  br label %after6
after6:
  %v11 = phi ptr [ %a1, %then5 ], [ %q, %entry ]
  call void @body_inertial(ptr %v11, ptr %qd, ptr %tau, ptr %free, ptr %out)
  ret void
}

define internal void @step(ptr %q, ptr %qd, ptr %qdd, ptr %tau, ptr %free) {
entry:
  %a1 = alloca [2 x double], align 64
  %a2 = alloca [2 x double], align 64
  %a3 = alloca [2 x double], align 64
  %v4 = load double, ptr %q, align 8
  %v5 = getelementptr double, ptr %q, i64 1
  %v6 = load double, ptr %v5, align 8
  %v7 = load double, ptr %qd, align 8
  %v8 = getelementptr double, ptr %qd, i64 1
  %v9 = load double, ptr %v8, align 8
  %v10 = load double, ptr %qdd, align 8
  %v11 = getelementptr double, ptr %qdd, i64 1
  %v12 = load double, ptr %v11, align 8
  %v13 = fmul double 0x3F40000000000000, %v10
  %v14 = fmul double 0x3F40000000000000, %v12
  %v15 = fadd double %v7, %v13
  %v16 = fadd double %v9, %v14
  %v17 = fmul double 0x3F50000000000000, %v15
  %v18 = fmul double 0x3F50000000000000, %v16
  %v19 = fadd double %v4, %v17
  %v20 = fadd double %v6, %v18
  %v21 = fmul double 0x3F50000000000000, %v10
  %v22 = fmul double 0x3F50000000000000, %v12
  %v23 = fadd double %v7, %v21
  %v24 = fadd double %v9, %v22
  store double %v19, ptr %a1, align 8
  store double %v23, ptr %a2, align 8
  %v25 = getelementptr double, ptr %a1, i64 1
  store double %v20, ptr %v25, align 8
  %v26 = getelementptr double, ptr %a2, i64 1
  store double %v24, ptr %v26, align 8
  call void @evaluate(ptr %a1, ptr %a2, ptr %tau, ptr %free, ptr %a3)
  %v27 = load double, ptr %a3, align 8
  %v28 = getelementptr double, ptr %a3, i64 1
  %v29 = load double, ptr %v28, align 8
  %v30 = fadd double %v10, %v27
  %v31 = fadd double %v12, %v29
  %v32 = fmul double 0x3F40000000000000, %v30
  %v33 = fmul double 0x3F40000000000000, %v31
  %v34 = fadd double %v7, %v32
  %v35 = fadd double %v9, %v33
  store double %v19, ptr %q, align 8
  %v36 = getelementptr double, ptr %q, i64 1
  store double %v20, ptr %v36, align 8
  store double %v34, ptr %qd, align 8
  %v37 = getelementptr double, ptr %qd, i64 1
  store double %v35, ptr %v37, align 8
  store double %v27, ptr %qdd, align 8
  %v38 = getelementptr double, ptr %qdd, i64 1
  store double %v29, ptr %v38, align 8
  ret void
}

define internal void @brake(ptr %q, ptr %qd, ptr %free) {
entry:
  %a16 = alloca [2 x double], align 64
  %a17 = alloca [2 x double], align 64
  %a18 = alloca [2 x double], align 64
  %v1 = load double, ptr %free, align 8
  %v2 = load double, ptr %qd, align 8
  %v3 = fcmp ole double %v1, 0x0000000000000000
  %v4 = fcmp une double %v2, 0x0000000000000000
  %v5 = and i1 %v3, %v4
  %v6 = getelementptr double, ptr %free, i64 1
  %v7 = load double, ptr %v6, align 8
  %v8 = getelementptr double, ptr %qd, i64 1
  %v9 = load double, ptr %v8, align 8
  %v10 = fcmp ole double %v7, 0x0000000000000000
  %v11 = fcmp une double %v9, 0x0000000000000000
  %v12 = and i1 %v10, %v11
  %v13 = or i1 %v5, %v12
  br i1 %v13, label %then14, label %after15, !prof !0
then14:
  store double 0x0000000000000000, ptr %a16, align 8
  %v19 = getelementptr double, ptr %a16, i64 1
  store double 0x0000000000000000, ptr %v19, align 8
  call void @evaluate_momentum(ptr %q, ptr %a16, ptr %qd, ptr %a17)
  call void @evaluate_inertial(ptr %q, ptr %a16, ptr %a17, ptr %free, ptr %a18)
  %v20 = load double, ptr %free, align 8
  %v21 = load double, ptr %qd, align 8
  %v22 = load double, ptr %a18, align 8
  %v23 = fcmp ogt double %v20, 0x0000000000000000
  %v24 = select i1 %v23, double %v22, double 0x0000000000000000
  %v25 = select i1 %v13, double %v24, double %v21
  store double %v25, ptr %qd, align 8
  %v26 = getelementptr double, ptr %free, i64 1
  %v27 = load double, ptr %v26, align 8
  %v28 = getelementptr double, ptr %qd, i64 1
  %v29 = load double, ptr %v28, align 8
  %v30 = getelementptr double, ptr %a18, i64 1
  %v31 = load double, ptr %v30, align 8
  %v32 = fcmp ogt double %v27, 0x0000000000000000
  %v33 = select i1 %v32, double %v31, double 0x0000000000000000
  %v34 = select i1 %v13, double %v33, double %v29
  %v35 = getelementptr double, ptr %qd, i64 1
  store double %v34, ptr %v35, align 8
  br label %after15
after15:
  ret void
}

define i64 @rollout(i64 %steps, ptr %substeps, ptr %q, ptr %qd, ptr %taus, ptr %free, ptr %out.q, ptr %out.qd) {
entry:
  %a1 = alloca [2 x double], align 64
  br label %loop2
loop2:
  %v3 = phi i64 [ 0, %entry ], [ %v38, %done15 ]
  %v4 = phi i64 [ zeroinitializer, %entry ], [ %v33, %done15 ]
  %v5 = mul i64 %v3, 2
  %v6 = getelementptr double, ptr %taus, i64 %v5
  call void @brake(ptr %q, ptr %qd, ptr %free)
  call void @evaluate(ptr %q, ptr %qd, ptr %v6, ptr %free, ptr %a1)
  br label %loop7
loop7:
  %v8 = phi i64 [ 0, %loop2 ], [ %v12, %loop7 ]
  call void @step(ptr %q, ptr %qd, ptr %a1, ptr %v6, ptr %free)
  %v9 = load atomic i64, ptr %substeps monotonic, align 8
  %v10 = add i64 %v8, 1
  %v11 = icmp ult i64 %v10, %v9
  %v12 = add i64 %v8, 1
  %v13 = icmp ult i64 %v12, 9223372036854775807
  %v14 = and i1 %v11, %v13
  br i1 %v14, label %loop7, label %done15
done15:
  %v16 = load double, ptr %q, align 8
  %v17 = getelementptr double, ptr %q, i64 1
  %v18 = load double, ptr %v17, align 8
  %v19 = load double, ptr %qd, align 8
  %v20 = getelementptr double, ptr %qd, i64 1
  %v21 = load double, ptr %v20, align 8
  %v22 = call double @llvm.fma.f64(double %v16, double 0x0000000000000000, double 0x0000000000000000)
  %v23 = call double @llvm.fma.f64(double %v18, double 0x0000000000000000, double 0x0000000000000000)
  %v24 = call double @llvm.fma.f64(double %v19, double 0x0000000000000000, double 0x0000000000000000)
  %v25 = call double @llvm.fma.f64(double %v21, double 0x0000000000000000, double 0x0000000000000000)
  %v26 = fadd double %v22, %v23
  %v27 = fadd double %v24, %v25
  %v28 = fadd double %v26, %v27
  %v29 = fcmp ord double %v28, %v28
  %v30 = icmp eq i64 %v4, %v3
  %v31 = and i1 %v30, %v29
  %v32 = zext i1 %v31 to i64
  %v33 = add i64 %v4, %v32
  %v34 = getelementptr double, ptr %out.q, i64 %v5
  store double %v16, ptr %v34, align 8
  %v35 = getelementptr double, ptr %v34, i64 1
  store double %v18, ptr %v35, align 8
  %v36 = getelementptr double, ptr %out.qd, i64 %v5
  store double %v19, ptr %v36, align 8
  %v37 = getelementptr double, ptr %v36, i64 1
  store double %v21, ptr %v37, align 8
  %v38 = add i64 %v3, 1
  %v39 = icmp ult i64 %v38, %steps
  br i1 %v39, label %loop2, label %done40
done40:
  ret i64 %v33
}

define void @accelerations(i64 %steps, ptr %qs, ptr %qds, ptr %taus, ptr %free, ptr %qdds) {
entry:
  br label %loop1
loop1:
  %v2 = phi i64 [ 0, %entry ], [ %v8, %loop1 ]
  %v3 = mul i64 %v2, 2
  %v4 = getelementptr double, ptr %qs, i64 %v3
  %v5 = getelementptr double, ptr %qds, i64 %v3
  %v6 = getelementptr double, ptr %taus, i64 %v3
  %v7 = getelementptr double, ptr %qdds, i64 %v3
  call void @evaluate(ptr %v4, ptr %v5, ptr %v6, ptr %free, ptr %v7)
  %v8 = add i64 %v2, 1
  %v9 = icmp ult i64 %v8, %steps
  br i1 %v9, label %loop1, label %done10
done10:
  ret void
}
