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

define i64 @rollout(i64 %steps, i64 %substeps, ptr %q, ptr %qd, ptr %taus, ptr %free, ptr %out.q, ptr %out.qd) {
entry:
  %a1 = alloca [2 x double], align 64
  br label %loop2
loop2:
  %v3 = phi i64 [ 0, %entry ], [ %v45, %done22 ]
  %v4 = phi i64 [ zeroinitializer, %entry ], [ %v40, %done22 ]
  %v5 = mul i64 %v3, 2
  %v6 = getelementptr double, ptr %taus, i64 %v5
  %v7 = load double, ptr %free, align 8
  %v8 = load double, ptr %qd, align 8
  %v9 = fcmp ogt double %v7, 0x0000000000000000
  %v10 = select i1 %v9, double %v8, double 0x0000000000000000
  store double %v10, ptr %qd, align 8
  %v11 = getelementptr double, ptr %free, i64 1
  %v12 = load double, ptr %v11, align 8
  %v13 = getelementptr double, ptr %qd, i64 1
  %v14 = load double, ptr %v13, align 8
  %v15 = fcmp ogt double %v12, 0x0000000000000000
  %v16 = select i1 %v15, double %v14, double 0x0000000000000000
  %v17 = getelementptr double, ptr %qd, i64 1
  store double %v16, ptr %v17, align 8
  call void @evaluate(ptr %q, ptr %qd, ptr %v6, ptr %free, ptr %a1)
  br label %loop18
loop18:
  %v19 = phi i64 [ 0, %loop2 ], [ %v20, %loop18 ]
  call void @step(ptr %q, ptr %qd, ptr %a1, ptr %v6, ptr %free)
  %v20 = add i64 %v19, 1
  %v21 = icmp ult i64 %v20, %substeps
  br i1 %v21, label %loop18, label %done22
done22:
  %v23 = load double, ptr %q, align 8
  %v24 = getelementptr double, ptr %q, i64 1
  %v25 = load double, ptr %v24, align 8
  %v26 = load double, ptr %qd, align 8
  %v27 = getelementptr double, ptr %qd, i64 1
  %v28 = load double, ptr %v27, align 8
  %v29 = call double @llvm.fma.f64(double %v23, double 0x0000000000000000, double 0x0000000000000000)
  %v30 = call double @llvm.fma.f64(double %v25, double 0x0000000000000000, double 0x0000000000000000)
  %v31 = call double @llvm.fma.f64(double %v26, double 0x0000000000000000, double 0x0000000000000000)
  %v32 = call double @llvm.fma.f64(double %v28, double 0x0000000000000000, double 0x0000000000000000)
  %v33 = fadd double %v29, %v30
  %v34 = fadd double %v31, %v32
  %v35 = fadd double %v33, %v34
  %v36 = fcmp ord double %v35, %v35
  %v37 = icmp eq i64 %v4, %v3
  %v38 = and i1 %v37, %v36
  %v39 = zext i1 %v38 to i64
  %v40 = add i64 %v4, %v39
  %v41 = getelementptr double, ptr %out.q, i64 %v5
  store double %v23, ptr %v41, align 8
  %v42 = getelementptr double, ptr %v41, i64 1
  store double %v25, ptr %v42, align 8
  %v43 = getelementptr double, ptr %out.qd, i64 %v5
  store double %v26, ptr %v43, align 8
  %v44 = getelementptr double, ptr %v43, i64 1
  store double %v28, ptr %v44, align 8
  %v45 = add i64 %v3, 1
  %v46 = icmp ult i64 %v45, %steps
  br i1 %v46, label %loop2, label %done47
done47:
  ret i64 %v40
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
